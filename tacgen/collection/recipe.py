"""Recipes: one YAML a job, checked whole before anything runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)

from tacgen.contact.law import PUBLISHED_K_N_MM3_PER_N
from tacgen.core.config import Axis, Finite, Section
from tacgen.core.errors import RecipeError
from tacgen.core.files import is_file, sha256_of_content
from tacgen.core.resources import find_recipe, object_folders, sensor_path
from tacgen.core.yaml_source import YamlSource, read_yaml, validate
from tacgen.physics.settings import PhysicsSettings, force_problem
from tacgen.sensor.description import SensorByName, SensorChoice


class Grid(Section):
    """Axes of the grid; an axis left out is taken from the object's own grasp ranges."""

    force_n: Axis | None = None
    x_mm: Axis | None = None
    y_mm: Axis | None = None
    z_mm: Axis | None = None
    yaw_rad: Axis = (0.0,)
    sample: PositiveInt | None = None


class ObjectEntry(Section):
    """An object to grasp, with what this recipe says otherwise than its ``object.yaml``."""

    name: str
    friction: NonNegativeFloat | None = None
    mass_kg: PositiveFloat | None = None
    center_of_mass_offset_mm: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    spinning_friction_mm: NonNegativeFloat | None = None
    scale: PositiveFloat = 1.0
    grid: Grid | None = None

    @model_serializer(mode="wrap")
    def _without_the_usual(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Keys that came later are left out at their usual value: older recipes keep their hash."""
        written = dict(serialize(self))
        for name in ("spinning_friction_mm", "scale"):
            if getattr(self, name) == type(self).model_fields[name].default:
                written.pop(name, None)
        return written


def _object_entry(given: Any) -> Any:
    return {"name": given} if isinstance(given, str) else given


class Robot(Section):
    """Which robot grasps, and what it can do."""

    name: Literal["wsg50", "ur5e_wsg50"] = "wsg50"
    max_force_n: PositiveFloat = 40.0
    tactile_pads: Literal["left", "right", "both"] = "left"


class Contact(Section):
    """How force becomes deformation: a calibrated ``contact.yaml``, or the figures themselves."""

    file: str | None = None
    law: Literal["volume_linear", "linear_depth"] = "volume_linear"
    k_n_mm3_per_n: PositiveFloat = PUBLISHED_K_N_MM3_PER_N
    k_s_mm_per_n: NonNegativeFloat = 1.0
    k_depth_mm_per_n: PositiveFloat = 0.02
    camera: Literal["raster", "pyrender"] = "raster"


class Optics(Section):
    """Switches of the renderer."""

    shadows: bool = False
    markers: bool = False
    noise: bool = True


class Frames(Section):
    """The tactile frames of a grasp: the moment of grasp alone, or a sequence from closing on."""

    mode: Literal["single", "sequence"] = "single"
    count: PositiveInt = 24
    span_s: PositiveFloat = 3.0


class Split(Section):
    """How configurations are divided; no configuration is on both sides."""

    test_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.2


class DatasetOptions(Section):
    """What the shards hold."""

    shard_size: PositiveInt = 25
    depth: bool = False
    scene_pictures: bool = True


class Randomize(Section):
    """Domain randomisation: standard deviations, drawn anew for each grasp from its own seed."""

    friction_relative: NonNegativeFloat = 0.0
    mass_relative: NonNegativeFloat = 0.0
    center_of_mass_mm: NonNegativeFloat = 0.0
    k_n_relative: NonNegativeFloat = 0.0
    sensor_gain_relative: NonNegativeFloat = 0.0
    position_mm: NonNegativeFloat = 0.0
    yaw_rad: NonNegativeFloat = 0.0


def _one_line(text: str) -> str:
    if "\n" in text or not text.strip():
        msg = f"is to be one line of text, got {text!r}"
        raise ValueError(msg)
    return text


Line = Annotated[str, AfterValidator(_one_line)]


class Cluster(Section):
    """Where batch jobs run and what they ask for; it changes no byte of the dataset.

    ``max_array`` is the most tasks of one array (None: asked of the scheduler), ``max_running``
    the most of them at a time; ``setup`` are shell lines before the job, ``sbatch`` any other
    options of sbatch, by their long names.
    """

    time_min: PositiveInt = 60
    mem_gb: PositiveFloat = 4.0
    cpus_per_task: PositiveInt = 1
    partition: Line | None = None
    account: Line | None = None
    qos: Line | None = None
    constraint: Line | None = None
    max_array: PositiveInt | None = None
    max_running: PositiveInt = 256
    shards_per_task: PositiveInt = 20
    max_timeouts: NonNegativeInt = 20
    setup: tuple[Line, ...] = ()
    sbatch: Mapping[str, bool | int | Line] = Field(default_factory=dict)


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
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    objects: tuple[Annotated[ObjectEntry, BeforeValidator(_object_entry)], ...] = Field(
        min_length=1
    )
    grid: Grid = Grid()
    split: Split = Split()
    robot: Robot = Robot()
    physics: Annotated[PhysicsSettings, BeforeValidator(_physics_settings)] = PhysicsSettings()
    sensor: SensorByName = SensorChoice()
    contact: Contact = Contact()
    optics: Optics = Optics()
    frames: Frames = Frames()
    dataset: DatasetOptions = DatasetOptions()
    randomize: Randomize = Randomize()
    cluster: Cluster = Cluster()

    @property
    def physics_settings(self) -> PhysicsSettings:
        """The settings of the simulation, with what the section ``robot`` says of the gripper."""
        return replace(
            self.physics,
            max_force_n=self.robot.max_force_n,
            tactile_pads=self.robot.tactile_pads,
        )

    def resolved(self) -> dict[str, Any]:
        """Every setting that a byte of the dataset can depend on, written or not, as plain data.

        The section ``cluster`` is left out: where a job runs changes nothing of what it makes.
        """
        return self.model_dump(mode="json", exclude={"physics": _BELONGS_TO_ROBOT, "cluster": True})

    def sha256(self) -> str:
        """A hash of ``resolved``, the same for recipes that mean the same."""
        return sha256_of_content(self.resolved())


def load_recipe(name: str | Path) -> Recipe:
    """Read and check the recipe ``name`` (a path, or the name of a shipped one).

    Raises
    ------
    RecipeError
        Lists everything that is wrong, each with its file, line and the fix.
    """
    source = read_yaml(find_recipe(str(name)))
    recipe = validate(Recipe, source)
    problems = [
        *_unknown_names(recipe, source),
        *_repeated_objects(recipe, source),
        *_forces_out_of_range(recipe, source),
    ]
    if problems:
        raise RecipeError.from_problems(problems)
    return recipe


def with_cluster(recipe: Recipe, **settings: str | float | None) -> Recipe:
    """``recipe`` with these settings of its section ``cluster``; None leaves one as it is.

    Raises ``RecipeError``, which names every setting that cannot be.
    """
    cluster = cluster_section(recipe.cluster, **settings)
    return recipe.model_copy(update={"cluster": cluster})


def cluster_section(before: Cluster | None = None, **settings: object) -> Cluster:
    """The section ``cluster`` with these settings; None leaves one as it is.

    Raises ``RecipeError``, which names every setting that cannot be.
    """
    given = {name: value for name, value in settings.items() if value is not None}
    try:
        return Cluster.model_validate((before or Cluster()).model_dump() | given)
    except ValidationError as error:
        raise RecipeError.from_problems(
            [f"cluster.{d['loc'][0]} = {d['input']!r}: {d['msg']}" for d in error.errors()]
        ) from None


def _unknown_names(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    known = object_folders()
    for i, entry in enumerate(recipe.objects):
        if entry.name not in known and not is_file(Path(entry.name) / "object.yaml"):
            yield source.problem(
                ("objects", i),
                f"= {entry.name!r} is not an object here; known: {', '.join(known)}; "
                "add your own mesh with `tacgen objects add`",
            )
    try:
        sensor_path(recipe.sensor.name)
    except RecipeError as error:
        yield source.problem(("sensor",), f"= {recipe.sensor.name!r}: {error}")


def _repeated_objects(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    names = [entry.name for entry in recipe.objects]
    for i, name in enumerate(names):
        if name in names[:i]:
            yield source.problem(
                ("objects", i), f"= {name!r} stands there twice; keep one, or make two recipes"
            )


def _forces_out_of_range(recipe: Recipe, source: YamlSource) -> Iterable[str]:
    grids: list[tuple[tuple[str | int, ...], Grid]] = [(("grid",), recipe.grid)]
    grids += [
        (("objects", i, "grid"), entry.grid)
        for i, entry in enumerate(recipe.objects)
        if entry.grid is not None
    ]
    for key_path, grid in grids:
        for k, force_n in enumerate(grid.force_n or ()):
            problem = force_problem(force_n, recipe.robot.max_force_n)
            if problem:
                yield source.problem((*key_path, "force_n", k), problem)
