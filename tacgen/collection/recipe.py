"""Recipes: one YAML a job, checked whole before anything runs."""

import contextlib
import math
import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    ValidationError,
)

from tacgen.collection.scene_section import Scene
from tacgen.core.errors import ObjectError, PhysicsError, RecipeError, TacgenError, missing_extra
from tacgen.core.files import sha256_of_content
from tacgen.core.progress import print_once
from tacgen.core.records import unit_problems
from tacgen.core.resources import (
    contact_law_path,
    find_object_folder,
    object_folders,
    sensor_path,
    unknown_object_hint,
)
from tacgen.core.schema import (
    Axis,
    KeyPath,
    Located,
    Section,
    YamlSource,
    as_named,
    load_checked,
    problem_text,
)
from tacgen.core.sensors import (
    SensorByName,
    SensorChoice,
    load_sensor,
    sensor_problems,
)
from tacgen.core.types import PUBLISHED_K_N_MM3_PER_N, k_n_doubt
from tacgen.dataset.manifest import MAX_SHARD_GRASPS
from tacgen.dataset.schema import MAX_CELLS
from tacgen.physics.robots import RobotSpec, gripper_file, load_robot
from tacgen.physics.settings import (
    MAX_FORCE_N,
    FrameRequest,
    Pads,
    PhysicsSettings,
    force_problem,
)


class Grid(Located):
    """Axes of the grid of grasps; an axis that is not given has the object's own grasp ranges."""

    file: str | None = None
    """A CSV that lists the grasps, as a path from the recipe's folder: ``object``, ``force_n``,
    ``x_mm``, ``y_mm``, ``z_mm``, ``yaw_rad``, ``split``, as ``tacgen grid`` prints. The axes are
    then those from which ``tacgen grid --near-border`` chooses more."""
    force_n: Axis | None = None
    """Force of each finger: a number, a list, ``{linspace: [first, last, count]}``,
    ``{geomspace: …}`` or ``{range: [first, last, step]}``."""
    x_mm: Axis | None = None
    """Gripper's centre along world x, from the centre of the object's footprint."""
    y_mm: Axis | None = None
    """Gripper's centre along world y, from the centre of the object's footprint."""
    z_mm: Axis | None = None
    """Height of the pads' centre above the table."""
    yaw_rad: Axis = (0.0,)
    """Gripper's angle about z; at 0 the fingers close along world x."""
    sample: PositiveInt | None = None
    """Number of grasps drawn at random from the grid, per object; all if not given."""

    def path(self) -> Path | None:
        """The path of ``file``; None if the recipe gives axes."""
        return None if self.file is None else _grasp_list_path(self.file, beside=self.folder)


def _grasp_list_path(name: str, *, beside: Path | None = None) -> Path:
    return (beside or Path()) / name


class ObjectEntry(Located):
    """An object to grasp, with the values that differ from its ``object.yaml``."""

    path_key: ClassVar[str] = "name"
    name: str
    """Name of an object (shipped, in ``./objects`` or in ``objects`` beside the recipe)."""
    dataset_name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")] | None = None
    """Name that it has in the dataset, its own if not given: one object can then be listed several
    times, with other figures."""
    friction: NonNegativeFloat | None = None
    """Coulomb friction coefficient against the gel."""
    mass_kg: PositiveFloat | None = None
    """Mass."""
    added_mass_kg: NonNegativeFloat = 0.0
    """A weight that is fixed to the object, on top of its mass."""
    added_mass_at_mm: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None
    """Where the weight is in the object's frame; at its centre of mass if not given."""
    center_of_mass_offset_mm: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (0.0, 0.0, 0.0)
    """Shift of the centre of mass in the object's frame."""
    spinning_friction_mm: NonNegativeFloat | None = None
    """Largest moment about the contact normal per newton of normal force, instead of the gel's."""
    spinning_friction_factor: NonNegativeFloat = 1.0
    """Factor on the moment that the pads hold about the contact normal."""
    scale: PositiveFloat = 1.0
    """Factor on the object's size."""
    grid: Grid | None = None
    """Axes for this object only."""

    def object_folder(self) -> Path:
        """The folder of the object."""
        return find_object_folder(self.name, beside=self.folder)

    @property
    def object_name(self) -> str:
        """The object's name in the dataset, also where ``name`` is the path of its folder."""
        return self.dataset_name or (Path(self.name).name if "/" in self.name else self.name)

    def figures(self) -> dict[str, Any]:
        """What it says of the object itself, as plain data."""
        return self.model_dump(mode="json", exclude={"name", "dataset_name", "grid"})


ObjectByName = Annotated[
    ObjectEntry, BeforeValidator(as_named, json_schema_input_type=str | ObjectEntry)
]
"""An object in a recipe: its name, or an :class:`ObjectEntry`."""


class Robot(Located):
    """The robot that grasps."""

    path_key: ClassVar[str] = "name"

    name: str = "wsg50"
    """A gripper (one of ``recipes/grippers``, or the path of a YAML file), which floats; with
    ``ur5e_`` before its name it is on a UR5e arm."""
    max_force_n: Annotated[PositiveFloat, Field(le=MAX_FORCE_N)] | None = None
    """Largest force of a finger; the gripper's own if not given."""
    tactile_pads: Pads = "left"
    """Fingers that carry a sensor."""

    def spec(self) -> RobotSpec:
        """The robot of that name.

        Raises ``PhysicsError`` if there is none, ``RecipeError`` if its gripper's file is wrong.
        """
        return load_robot(self.name, beside=self.folder)

    def gripper_file(self) -> Path:
        """The YAML file of its gripper."""
        return gripper_file(self.name, beside=self.folder)

    @property
    def largest_force_n(self) -> float:
        """Largest force of a finger."""
        return self.max_force_n or self.spec().gripper.force_range_n[1]


class Contact(Located):
    """The contact law: a calibrated ``contact.yaml``, or its coefficients."""

    file: str | None = None
    """A ``contact.yaml``, as a path from the recipe's folder; replaces law and coefficients."""
    law: Literal["volume_linear", "linear_depth"] = "volume_linear"
    """V = k_n F_n, or TACTO's depth proportional to the force."""
    k_n_mm3_per_n: PositiveFloat = PUBLISHED_K_N_MM3_PER_N
    """Indented volume per normal force."""
    k_s_mm_per_n: NonNegativeFloat = 1.0
    """Sum of the motion of markers 2 mm apart per shear force."""
    k_depth_mm_per_n: PositiveFloat = 0.02
    """Indentation per normal force, for ``linear_depth``."""
    collision_margin_mm: NonNegativeFloat = 0.0
    """Gap that the physics keeps between object and gel, which ``linear_depth`` as TACTO has it
    does not take back: below margin / k_depth newtons the image loses the contact. Bullet keeps
    1 mm around each convex hull: 1 against a box, 2 between meshes."""
    camera: Literal["raster", "pyrender"] = "raster"
    """Renderer of the gap map: tacgen's own, or pyrender (needs OpenGL)."""

    def path(self) -> Path | None:
        """The path of ``file``; None if the recipe gives coefficients."""
        return None if self.file is None else contact_law_path(self.file, beside=self.folder)


def _device_of(choice: str) -> str:
    """The device that ``choice`` means here: ``auto`` is a GPU, or else none, which it says."""
    if choice != "auto":
        return "none" if choice == "cpu" else choice
    problem = missing_extra("batch", "it needs")
    if not problem:
        import warp as wp

        wp.config.log_level = wp.LOG_ERROR  # standard output is for results
        try:
            problem = "" if wp.is_cuda_available() else "Warp finds no CUDA GPU"
        except OSError as error:
            problem = f"Warp cannot keep what it compiles ({error}); set WARP_CACHE_PATH"
    if problem:
        print_once(f"optics.device = auto: images are drawn as without the key, since {problem}")
    return "none" if problem else "cuda"


class Optics(Section):
    """The renderer."""

    shadows: bool = False
    """Draw the shadows of the sensor's lights."""
    markers: bool = False
    """Draw the gel's dots, moved by pressure, shear and twist."""
    noise: Literal[True, False, "at_load"] = True
    """Add the camera's noise; ``at_load``: only when images are read, for smaller files."""
    device: Annotated[Literal["none", "auto", "cpu", "cuda"], AfterValidator(_device_of)] = "none"
    """Draw the images of a grasp at once, in Warp (the extra ``batch``), on a GPU (``cuda``), with
    ``auto`` on a GPU where there is one; ``none`` and ``cpu`` draw them one by one on the CPU. Grey
    levels differ by up to 1 between the two."""


class Split(Section):
    """Division into training and test grasps; no configuration is in both."""

    test_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.2
    """Share of each object's grasps that are test grasps."""


_Cells = Annotated[int, Field(ge=1, le=MAX_CELLS)]


def _depth_kept(given: Any) -> Any:
    """``true`` and ``false`` as recipes said it before there was ``all``."""
    return {True: "grasp", False: "none"}[given] if isinstance(given, bool) else given


class DatasetOptions(Section):
    """Content of the shards."""

    shard_size: Annotated[PositiveInt, Field(le=MAX_SHARD_GRASPS)] = 25
    """Grasps per shard."""
    depth: Annotated[
        Literal["none", "grasp", "all"],
        BeforeValidator(_depth_kept, json_schema_input_type=Literal["none", "grasp", "all"] | bool),
    ] = "none"
    """Also store depth maps: of the moment of ``grasp`` (or ``true``), or of ``all`` frames."""
    markers: bool = False
    """Also store how far each marker is from its place at rest, in every frame; of a gel without
    markers, points of a grid of 2 mm."""
    force_field: tuple[_Cells, _Cells] | None = None
    """``[rows, columns]`` of a grid over the gel's window: also store the force on each cell, in
    every frame."""
    scene_pictures: bool = True
    """Also store a small picture of the scene for the gallery."""


class Randomize(Section):
    """Domain randomisation: standard deviations, drawn anew for each grasp from its own seed."""

    friction_relative: NonNegativeFloat = 0.0
    """Friction coefficient, relative (log-normal)."""
    mass_relative: NonNegativeFloat = 0.0
    """Mass, relative (log-normal)."""
    center_of_mass_mm: NonNegativeFloat = 0.0
    """Centre of mass along each axis."""
    k_n_relative: NonNegativeFloat = 0.0
    """k_n of the contact law, relative (log-normal)."""
    sensor_gain_relative: NonNegativeFloat = 0.0
    """Gain of the camera, relative (log-normal)."""
    position_mm: NonNegativeFloat | tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat] = (
        0.0
    )
    """Position of the gripper along each axis, or along x, y and z."""
    yaw_rad: NonNegativeFloat = 0.0
    """Angle of the gripper about z."""


class Uncertainty(Section):
    """How exactly a grasp is repeated: standard deviations for ``label_confidence``."""

    force_relative: NonNegativeFloat = 0.05
    """Force of the gripper, relative; assumed."""
    friction_relative: NonNegativeFloat = 0.05
    """Friction coefficient, relative; a step of ``tacgen friction`` at a usual 0.4 is 0.06."""
    position_mm: NonNegativeFloat = 1.0
    """Place of the gripper across the fingers' closing; assumed."""


def _one_line(text: str) -> str:
    if "\n" in text or not text.strip():
        msg = f"is to be one line of text, got {text!r}"
        raise ValueError(msg)
    return text


Line = Annotated[str, AfterValidator(_one_line)]


class Cluster(Section):
    """Resources of batch jobs; they do not affect the dataset."""

    time_min: PositiveInt = 60
    """Minutes after which a job is requeued."""
    mem_gb: PositiveFloat = 4.0
    """Memory of a job."""
    cpus_per_task: PositiveInt = 1
    """Worker processes of a job."""
    partition: Line | None = None
    """Slurm partition."""
    account: Line | None = None
    """Slurm account."""
    qos: Line | None = None
    """Slurm quality of service."""
    constraint: Line | None = None
    """Slurm constraint on nodes."""
    max_array: PositiveInt | None = None
    """Most jobs of one array; the scheduler's own limit if not given."""
    max_running: PositiveInt = 256
    """Most jobs of an array that run at a time."""
    shards_per_task: PositiveInt = 20
    """Shards per job."""
    max_timeouts: NonNegativeInt = 20
    """How often a job is requeued after its time limit."""
    setup: tuple[Line, ...] = ()
    """Shell lines before the job, such as ``module load python``."""
    sbatch: Mapping[str, bool | int | Line] = Field(default_factory=dict)
    """Other options of sbatch, by their long names."""


_BELONGS_TO_ROBOT = {"max_force_n", "tactile_pads"}


def _physics_settings(given: Any) -> Any:
    moved = _BELONGS_TO_ROBOT & set(given if isinstance(given, dict) else ())
    if moved:
        msg = f"{', '.join(sorted(moved))}: belongs to the section `robot`; move it there"
        raise ValueError(msg)
    return given


class Recipe(Section):
    """One job, from the grid to the shards."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    """Name of the dataset."""
    description: str = ""
    """One sentence for the dataset's card."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of every random number."""
    objects: tuple[ObjectByName, ...] = Field(min_length=1)
    """Objects to grasp: names, or sections with a name."""
    grid: Grid = Grid()
    """Grid of grasps for all objects."""
    split: Split = Split()
    """Training and test grasps."""
    robot: Robot = Robot()
    """The robot."""
    physics: Annotated[PhysicsSettings, BeforeValidator(_physics_settings)] = PhysicsSettings()
    """The simulation of a grasp."""
    sensor: SensorByName = SensorChoice()
    """The sensor: a name, or a section with a name."""
    contact: Contact = Contact()
    """The contact law."""
    optics: Optics = Optics()
    """The renderer."""
    frames: FrameRequest = FrameRequest()
    """Tactile images of a grasp."""
    dataset: DatasetOptions = DatasetOptions()
    """Content of the shards."""
    scene: Scene = Scene()
    """Cameras beside the tactile pads."""
    randomize: Randomize = Randomize()
    """Domain randomisation."""
    uncertainty: Uncertainty = Uncertainty()
    """How exactly a grasp is repeated."""
    cluster: Cluster = Cluster()
    """Batch jobs."""

    @property
    def physics_settings(self) -> PhysicsSettings:
        """The settings of the simulation, with what the section ``robot`` says of the gripper."""
        return replace(
            self.physics,
            max_force_n=self.robot.largest_force_n,
            tactile_pads=self.robot.tactile_pads,
        )

    def entry_of(self, name: str) -> ObjectEntry:
        """The entry of an object; a plain one, found like the others, where there is none."""
        known = next((entry for entry in self.objects if entry.object_name == name), None)
        if known is not None:
            return known
        entry = ObjectEntry(name=name)
        entry._folder = self.objects[0].folder
        return entry

    def resolved(self, beside: Path | None = None) -> dict[str, Any]:
        """Every setting that a byte of the dataset can depend on, written or not, as plain data.

        The section ``cluster`` is not part of it: it does not affect the dataset. Files are named
        as in the recipe, or as a recipe in the folder ``beside`` names them.
        """
        found = self.model_dump(
            mode="json", exclude={"physics": _BELONGS_TO_ROBOT, "cluster": True}
        )
        found["robot"]["max_force_n"] = self.robot.largest_force_n
        if beside is not None:
            _name_from(beside, found["contact"], "file", self.contact, contact_law_path)
            _name_from(beside, found["grid"], "file", self.grid, _grasp_list_path)
            _name_from(beside, found["robot"], "name", self.robot, gripper_file)
            _name_from(beside, found["sensor"], "name", self.sensor, sensor_path)
            if self.sensor.table is not None:
                table = Path(load_sensor(self.sensor).table).resolve()
                found["sensor"]["table"] = os.path.relpath(table, beside.resolve())
            for section, entry in zip(found["objects"], self.objects, strict=True):
                _name_from(beside, section, "name", entry, find_object_folder)
        return found

    def sha256(self) -> str:
        """A hash of ``resolved``, the same for recipes that mean the same."""
        return sha256_of_content(self.resolved())


def _name_from(
    folder: Path, section: dict[str, Any], key: str, given: Located, find: Callable[..., Path]
) -> None:
    """Name the file of a section as a recipe in ``folder`` does, if its name is another's there."""
    name = section[key]
    if name is None:
        return
    file = find(name, beside=given.folder).resolve()
    with contextlib.suppress(TacgenError):
        if find(name, beside=folder).resolve() == file:
            return
    arm = "ur5e_" if find is gripper_file and name.startswith("ur5e_") else ""
    section[key] = arm + os.path.relpath(file, folder.resolve())


def load_recipe(name: str | Path) -> Recipe:
    """Read and check the recipe ``name`` (a path, or the name of a shipped one).

    Raises
    ------
    RecipeError
        Lists everything that is wrong, each with its file, line and the fix.

    Examples
    --------
    >>> recipe = tacgen.load_recipe("quickstart")
    >>> recipe.name, recipe.sensor.name
    ('quickstart', 'gelsight')
    """
    checks = (
        _unknown_names,
        _repeated_objects,
        _values_out_of_range,
        _values_that_need_others,
        _misplaced_cameras,
    )
    return load_checked(Recipe, name, *checks)


def known_objects(recipe: Recipe) -> tuple[str, ...]:
    """Names of the objects that ``recipe`` and real grasps beside it may use."""
    names = [entry.object_name for entry in recipe.objects]
    return tuple(dict.fromkeys([*object_folders(recipe.objects[0].folder), *names]))


def with_cluster(recipe: Recipe, **settings: object) -> Recipe:
    """``recipe`` with the settings of its section ``cluster`` that are not None."""
    return recipe.model_copy(update={"cluster": cluster_section(recipe.cluster, **settings)})


def cluster_section(before: Cluster, **settings: object) -> Cluster:
    """The section ``cluster`` with the settings that are not None.

    Raises ``RecipeError``, which names every setting that cannot be.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    try:
        return Cluster.model_validate(before.model_dump() | given)
    except ValidationError as error:
        raise RecipeError.from_problems(
            [f"cluster.{d['loc'][0]} = {d['input']!r}: {problem_text(d)}" for d in error.errors()]
        ) from None


def _unknown_names(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    for i, entry in enumerate(recipe.objects):
        try:
            entry.object_folder()
        except ObjectError:
            hint = unknown_object_hint(entry.name, object_folders(entry.folder))
            yield source.problem(("objects", i), f"= {entry.name!r} is not an object here{hint}")
    markers = ("optics", "markers") if recipe.optics.markers else None
    yield from sensor_problems(recipe.sensor, source, markers)
    try:
        recipe.robot.spec()
    except (PhysicsError, RecipeError) as error:
        yield source.problem(("robot", "name"), f": {error}")


def _repeated_objects(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    names = [entry.object_name for entry in recipe.objects]
    return source.repeated("objects", names, "keep one, or give it another `dataset_name`")


def _misplaced_cameras(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    names = [one.name for one in recipe.scene.cameras]
    for i, name in enumerate(names):
        if name in names[:i]:
            text = f"= {name!r} is given twice; give each a name of its own"
            yield source.problem(("scene", "cameras", i, "name"), text)
    if not names:
        return
    # Slow to import, and most recipes do not need them.
    from tacgen.objects import load_object
    from tacgen.objects.meshes import is_inside

    for entry in recipe.objects:
        try:
            surface = load_object(entry.object_folder()).surface
        except ObjectError:  # which is a problem of its own
            continue
        for i, one in enumerate(recipe.scene.cameras):
            place_mm = one.camera().t_world_camera_mm[:3, 3] / entry.scale
            if is_inside(surface, place_mm):
                text = f"is inside {entry.object_name!r} as it stands; place it outside"
                yield source.problem(("scene", "cameras", i), text)


def _grids(recipe: Recipe) -> dict[KeyPath, Grid]:
    """The grids of a recipe by their place in it."""
    found: dict[KeyPath, Grid | None] = {("grid",): recipe.grid}
    found |= {("objects", i, "grid"): entry.grid for i, entry in enumerate(recipe.objects)}
    return {key_path: grid for key_path, grid in found.items() if grid is not None}


def _values_out_of_range(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    try:
        limit_n = recipe.robot.largest_force_n
    except (PhysicsError, RecipeError):  # which is a problem of its own
        limit_n = math.inf
    for key_path, grid in _grids(recipe).items():
        for name in ("z_mm", "yaw_rad"):
            if problem := unit_problems(name, np.array(getattr(grid, name) or ())):
                yield source.problem((*key_path, name), f"is {problem}")
        for k, force_n in enumerate(grid.force_n or ()):
            if problem := force_problem(force_n, limit_n):
                yield source.problem((*key_path, "force_n", k), problem)


def _values_that_need_others(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    for key_path, grid in _grids(recipe).items():
        if grid.file is not None and key_path != ("grid",):
            fix = "lists the grasps of all objects; give it in the section `grid` of the recipe"
            yield source.problem((*key_path, "file"), fix)
    contact = recipe.contact
    if contact.collision_margin_mm and (contact.file or contact.law != "linear_depth"):
        fix = "is of `law: linear_depth` alone; remove it"
        yield source.problem(("contact", "collision_margin_mm"), fix)
    for i, entry in enumerate(recipe.objects):
        if entry.added_mass_at_mm is not None and not entry.added_mass_kg:
            fix = "is the place of no weight; give added_mass_kg, or remove it"
            yield source.problem(("objects", i, "added_mass_at_mm"), fix)
    if contact.file is None and (doubt := k_n_doubt(contact.k_n_mm3_per_n)):
        yield source.problem(("contact", "k_n_mm3_per_n"), doubt)
