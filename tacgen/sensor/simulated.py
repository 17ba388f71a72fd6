"""A simulated tactile sensor for one's own script: rendered directly, or read from a simulation."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gap import pose_problem
from tacgen.contact.gel import gel_size_mm
from tacgen.contact.gel_response import GelCourse, gel_loads
from tacgen.contact.indenter import Imprint, contact_status
from tacgen.contact.law import ContactLaw, load_law
from tacgen.core.errors import ContactError, SensorError
from tacgen.core.records import ContactFrame, ContactStatus, Mesh
from tacgen.core.records import Sensor as Description
from tacgen.core.sensors import SensorChoice, load_sensor
from tacgen.core.types import MM_PER_M, FloatArray
from tacgen.sensor.tactile_pad import TactilePad

if TYPE_CHECKING:
    import trimesh

    from tacgen.sensor.engines import EngineContacts

MeshLike: TypeAlias = "trimesh.Trimesh | Mesh | tuple[FloatArray, NDArray[np.integer[Any]]]"

SMALLEST_OBJECT_MM = 1.0  # of which a mesh in metres is less, and what one presses is not
LEAST_MOVE_MM = 1e-6, 0.1
"""Below the first a translation is rounding; below the second it is less than one means in mm, and
up to a sensor's size in m."""


class _Touch:
    """The marker and the force field of an imprint, made when asked for; pickled as arrays."""

    def __init__(
        self, pad: TactilePad, imprint: Imprint, force_n: FloatArray, shape: tuple[int, int]
    ) -> None:
        self._of = pad, imprint, force_n, shape

    def __getstate__(self) -> dict[str, NDArray[np.float64]]:
        return {"markers_mm": self.markers_mm, "force_field_n": self.force_field_n}

    @cached_property
    def markers_mm(self) -> NDArray[np.float64]:
        pad, imprint, *_ = self._of
        return pad.marker_motion_mm(imprint)

    @cached_property
    def force_field_n(self) -> NDArray[np.float64]:
        pad, imprint, force_n, shape = self._of
        return pad.force_field_n(imprint, force_n, shape)


@dataclass(frozen=True, slots=True)
class Frame:
    """What the sensor shows at one time.

    Attributes
    ----------
    rgb : (H, W, 3) uint8
    depth_mm : (H, W) float32
        Indentation of the gel.
    contact_mask : (H, W) bool
    force_n : (3,) float64
        Force of the object on the gel that the image shows: along the gel's x and y, and into the
        gel. What acts on the gel beside the window is not in it, but in
    total_force_n : (3,) float64
        All that presses on the gel; NaN in a frame that was read from an image, which does not
        show it.
    indentation_mm, volume_mm3 : float
        Deepest indentation beyond first touch, and the displaced volume, in the window.
    markers_px : (n, 2) float64 or None
        Places x, y of the marker dots in the image; None without markers.
    saturated : bool
        Whether the gel is pressed through to its backing: more force would look the same.
    status : {"ok", "no_contact", "outside_window"}
        ``outside_window`` where more than a twentieth of what presses on the sensor does so beside
        the window.
    markers_mm : (M, 2) float64
        How far each marker is from its place at rest, x and y of the gel; of a gel without
        markers, points of a grid. Made when it is asked for, as is:
    force_field_n : (rows, columns, 3) float64
        Force on each cell of a grid over the window: along x, along y, into the gel. It sums to
        ``force_n``.
    """

    rgb: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    contact_mask: NDArray[np.bool_]
    force_n: NDArray[np.float64]
    indentation_mm: float
    volume_mm3: float
    markers_px: NDArray[np.float64] | None
    total_force_n: NDArray[np.float64] = field(
        default_factory=lambda: np.full(3, np.nan), kw_only=True
    )
    saturated: bool = field(default=False, kw_only=True)
    status: ContactStatus = field(default="ok", kw_only=True)
    _touch: _Touch | None = field(default=None, kw_only=True, repr=False, compare=False)

    @property
    def markers_mm(self) -> NDArray[np.float64]:
        """How far each marker is from its place at rest, (M, 2)."""
        return self._fields.markers_mm

    @property
    def force_field_n(self) -> NDArray[np.float64]:
        """Force on each cell, (rows, columns, 3): shear x, shear y, normal."""
        return self._fields.force_field_n

    @property
    def _fields(self) -> _Touch:
        if self._touch is None:
            msg = "this frame has no such field: only one that a Sensor simulates has"
            raise SensorError(msg)
        return self._touch


class Sensor:
    """A GelSight-like sensor with its calibrated table and contact law.

    Parameters
    ----------
    name : str
        A sensor of ``recipes/sensors`` (``gelsight``, ``gelsight_mini``, ``digit`` …) or the path
        of a YAML file.
    table : path, optional
        A ``table.npz`` from ``tacgen calibrate lookup``, instead of the sensor's own.
    contact : path or ContactLaw, optional
        A ``contact.yaml`` from ``tacgen calibrate contact``; the default is the published slope
        k_n = 5.135 mm³/N and k_s = 1 mm/N for markers 2 mm apart.
    mm_per_px, dome_radius_mm : float, optional
        Of the sensor that the table is of, instead of what the description says; 0: a flat gel.
    shadows, markers, noise : bool
        Cast shadows, printed dots, camera noise (drawn from ``seed``).
    force_field : (rows, columns), optional
        The cells of a frame's ``force_field_n``; the default is one for each marker.

    Raises
    ------
    RecipeError, TableError, ContactError
        If the sensor, its table or the law cannot be used.

    Examples
    --------
    >>> import numpy as np, tacgen, trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    >>> sensor = tacgen.Sensor("gelsight_mini")
    >>> frame = sensor.render(ball, np.eye(4), force_n=5.0)
    >>> round(frame.volume_mm3, 1)
    25.7
    """

    def __init__(
        self,
        name: str = "gelsight",
        table: str | Path | None = None,
        contact: str | Path | ContactLaw | None = None,
        *,
        mm_per_px: float | None = None,
        dome_radius_mm: float | None = None,
        shadows: bool = False,
        markers: bool = False,
        noise: bool = False,
        seed: int = 0,
        force_field: tuple[int, int] | None = None,
    ) -> None:
        choice = SensorChoice(
            name=str(name),
            table=None if table is None else str(table),
            mm_per_px=mm_per_px,
            dome_radius_mm=dome_radius_mm,
        )
        self.description = load_sensor(choice)
        if isinstance(contact, ContactLaw):
            self.law = contact
        else:
            self.law = ContactLaw.default() if contact is None else load_law(Path(contact))
        self._drawn: dict[str, Any] = {"shadows": shadows, "markers": markers}
        self._pad = TactilePad(self.description, **self._drawn)
        self.table = self._pad.table
        self._rng = np.random.default_rng(np.random.SeedSequence(seed)) if noise else None
        self._simulation: EngineContacts | None = None
        self._gel = GelCourse(self.law)
        self._began_s: float | None = None
        self._before: Imprint | None = None
        at_rest_mm = self.marker_rest_mm
        shape = force_field or tuple(len(np.unique(along)) for along in at_rest_mm.T[::-1])
        if len(shape) != 2 or not all(isinstance(n, (int, np.integer)) and n > 0 for n in shape):
            msg = f"force_field = {force_field}: give the numbers of its rows and columns"
            raise SensorError(msg)
        self._field_shape = int(shape[0]), int(shape[1])

    def __getstate__(self) -> dict[str, Any]:
        """What a copy, or another process, makes the same sensor of; nothing in it is shared.

        Raises ``SensorError`` if the sensor is attached.
        """
        if self._simulation is not None:
            msg = (
                "an attached sensor belongs to a simulation of this process and cannot be copied "
                "or pickled; send one that is not attached, and attach it there"
            )
            raise SensorError(msg)
        own = {"_gel": copy.copy(self._gel), "_rng": copy.deepcopy(self._rng)}
        return {name: value for name, value in vars(self).items() if name != "_pad"} | own

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._pad = TactilePad(self.description, self.table, **self._drawn)

    @property
    def marker_rest_mm(self) -> NDArray[np.float64]:
        """Places (M, 2) of the markers at rest, gel frame, mm: see ``Frame.markers_mm``."""
        return self._pad.marker_rest_mm

    def __repr__(self) -> str:
        height, width = self.description.shape_px
        k_n = self.law.k_n_mm3_per_n.value
        return f"Sensor({self.description.name!r}, {width}×{height} px, k_n = {k_n:g} mm³/N)"

    def render(
        self,
        mesh: MeshLike,
        pose_gel_object: FloatArray,
        force_n: float = 5.0,
        shear_n: Sequence[float] = (0.0, 0.0),
        *,
        torsion_n_mm: float = 0.0,
    ) -> Frame:
        """The frame of an object pressed into the gel at rest by a known force.

        Parameters
        ----------
        mesh : trimesh.Trimesh or (vertices_mm (n, 3), faces (m, 3))
            In mm, in the object's own frame.
        pose_gel_object : (4, 4)
            Object to gel frame, mm. Where along the gel's z the object stands does not matter:
            it is taken to first touch and pressed in from there. The gel is larger than the
            window (``gel_size_mm`` of the sensor's file, else 5 mm around it): what touches beside
            the window carries its part of the force.
        force_n, shear_n, torsion_n_mm
            Force of the object into the gel, along the gel's x and y, and the moment about the
            gel's normal through the middle of the contact patch.

        Raises
        ------
        ContactError
            If the mesh, the pose or the force cannot be used, or the object is beside the gel.
        """
        warn_of_metres(pose_gel_object, "pose_gel_object")
        frame = _contact_frame(0.0, force_n, shear_n, torsion_n_mm, pose_gel_object)
        solid, load = as_mesh(mesh), gel_loads(self.law, [frame])[0]
        if np.hypot(*frame.force_shear_n) > load.friction * force_n:
            text = (
                f"shear_n is more than friction holds ({load.friction:g} × {force_n:g} N): the "
                "object slides, and the gel moves no farther; `friction` of the contact law says "
                "how rough gel and object are"
            )
            warnings.warn(text, stacklevel=2)
        imprint = self._pad.press(solid, frame.pose_gel_object, load)
        if imprint.is_beside_gel:
            raise ContactError(beside_gel(solid, frame.pose_gel_object, self.description))
        return self._frame(frame, imprint)

    def at_rest_rgb(self) -> NDArray[np.uint8]:
        """The image (H, W, 3) of the gel with nothing on it, without noise."""
        return self._pad.at_rest_rgb.copy()

    def attach_pybullet(
        self,
        body_id: int,
        link_id: int = -1,
        *,
        pose_link_gel: FloatArray | None = None,
        client_id: int = 0,
    ) -> Sensor:
        """Attach to a link of a body in a running PyBullet simulation.

        ``pose_link_gel`` (4, 4), mm: gel frame to link frame; the default puts the gel's origin
        and axes on the link's.
        """
        from tacgen.sensor.attach_pybullet import PyBulletContacts

        pose_m = _pose(pose_link_gel, "pose_link_gel")
        self._simulation = PyBulletContacts(self.description, body_id, link_id, pose_m, client_id)
        self.reset()
        return self

    def attach_mujoco(
        self, model: Any, data: Any, body: int | str, *, pose_body_gel: FloatArray | None = None
    ) -> Sensor:
        """Attach to a body of a MuJoCo model; ``pose_body_gel`` (4, 4), mm: gel to body frame."""
        from tacgen.sensor.attach_mujoco import MujocoContacts

        pose_m = _pose(pose_body_gel, "pose_body_gel")
        self._simulation = MujocoContacts(self.description, model, data, body, pose_m)
        self.reset()
        return self

    def add_object(
        self, body_id: int | str, mesh: MeshLike | None = None, *, scale: float = 1.0
    ) -> Sensor:
        """Register a body that may touch the sensor, with its links or child bodies.

        ``mesh`` is in the body's own frame; ``scale`` takes it to mm (1000 for metres). Without
        one, the mesh is made from the shapes that the simulation itself collides; so is that of a
        link or child body that a given mesh does not enclose. What touches is what is pressed.
        """
        given = None if mesh is None else as_mesh(mesh, scale)
        self._attached().add_object(body_id, given)
        return self

    def read(self, time_s: float | None = None) -> Frame:
        """The frame at the simulation's present state, from its poses and contact forces.

        Shear and effects with memory (creep, hysteresis, conditioning) go on from frame to frame.
        The gel is at rest when the sensor is attached; ``reset`` begins a new press, as does a
        clock that goes back. PyBullet keeps no clock: there the gel is at rest until the first
        reading, and where such an effect matters and there is more than one step between readings,
        give ``time_s``.

        Raises ``SensorError`` if the sensor is not attached, or knows of no object.
        """
        simulation = self._attached()
        touch = simulation.contact()
        clock_s, last_s = simulation.clock_s(), self._gel.last_s
        if time_s is not None:
            now_s = float(time_s)
        elif clock_s is not None:
            now_s = clock_s
        else:
            now_s = 0.0 if last_s is None else last_s + simulation.time_step_s()
        if last_s is not None and now_s < last_s:
            self.reset()
        began_s = clock_s if self._began_s is None else self._began_s
        at_rest_s = 0.0 if clock_s is None or began_s is None else clock_s - began_s
        normal_n, shear_n = max(float(touch.force_n[2]), 0.0), touch.force_n[:2]
        pose = touch.pose_gel_object
        frame = _contact_frame(now_s, normal_n, shear_n, touch.torsion_n_mm, pose)
        frame = replace(frame, center_mm=touch.center_mm)
        load = self._gel.load(frame, at_rest_s)
        imprint = self._pad.press(touch.mesh, pose, load, self._before)
        if imprint.is_beside_gel and touch.is_over_gel:
            raise ContactError(beside_gel(touch.mesh, pose, self.description))
        if not touch.is_on_gel(imprint):
            imprint = Imprint(is_beside_gel=normal_n > 0)
        self._before = imprint
        return self._frame(frame, imprint, touch.share)

    def reset(self) -> None:
        """Begin a new press on a gel at rest."""
        self._gel.begin()
        self._before = None
        self._began_s = self._simulation.clock_s() if self._simulation else None

    def _attached(self) -> EngineContacts:
        if self._simulation is None:
            msg = "the sensor is not attached; call attach_pybullet or attach_mujoco first"
            raise SensorError(msg)
        return self._simulation

    def _frame(self, contact: ContactFrame, imprint: Imprint, share: float = 1.0) -> Frame:
        """The frame of a load that is this ``share`` of what presses on the sensor."""
        top, bottom, left, right = imprint.window
        contact_mask = np.zeros(self.description.shape_px, dtype=bool)
        contact_mask[top:bottom, left:right] = imprint.depth_mm > 0
        shown = imprint.share
        presses = contact.force_normal_n > 0 and not imprint.is_beside_gel
        total_force_n = contact.force_n if presses else np.zeros(3)
        force_n = shown * total_force_n if imprint.depth_mm.size else np.zeros(3)
        return Frame(
            rgb=self._pad.image(imprint, rng=self._rng),
            depth_mm=imprint.depth_map_mm(self.description),
            contact_mask=contact_mask,
            force_n=force_n,
            total_force_n=total_force_n,
            indentation_mm=imprint.indentation_mm,
            volume_mm3=imprint.volume_mm3,
            markers_px=self._markers_px(imprint),
            saturated=imprint.saturated,
            status=contact_status(share * shown, touches=imprint.indentation_mm > 0),
            _touch=_Touch(self._pad, imprint, force_n, self._field_shape),
        )

    def _markers_px(self, imprint: Imprint) -> NDArray[np.float64] | None:
        places_mm = self._pad.markers_mm(imprint)
        if places_mm is None:
            return None
        height, width = self.description.shape_px
        middle_px = np.array([width / 2 - 0.5, height / 2 - 0.5])
        return np.asarray(places_mm / self.description.mm_per_px + middle_px, np.float64)


def as_mesh(mesh: Any, scale: float = 1.0) -> Mesh:
    """A trimesh, a ``Mesh`` or (vertices_mm, faces) as a ``Mesh``; else a ``ContactError``."""
    if isinstance(mesh, Mesh):
        if scale == 1.0 and not (mesh.vertices_mm.flags.writeable or mesh.faces.flags.writeable):
            return mesh
        vertices, faces = mesh.vertices_mm, mesh.faces
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        vertices, faces = mesh.vertices, mesh.faces
    elif isinstance(mesh, (tuple, list)) and len(mesh) == 2:
        vertices, faces = mesh
    else:
        msg = f"a mesh is a trimesh.Trimesh or (vertices_mm, faces), not {type(mesh).__name__}"
        raise ContactError(msg)
    solid = Mesh.fixed(scale * np.asarray(vertices, np.float64), faces)
    # Of all three coordinates together, which is quicker and is as large or larger.
    if solid.vertices_mm.size and np.ptp(solid.vertices_mm) < SMALLEST_OBJECT_MM:
        size_mm = float(np.ptp(solid.vertices_mm, axis=0).max())
        text = f"the mesh is {size_mm:.3g} mm large: is it in metres? Scale it to mm, by 1000"
        warnings.warn(text, stacklevel=3)
    return solid


def warn_of_metres(pose_mm: Any, name: str) -> None:
    """Warn where a pose moves by so little that it is in metres rather than in mm."""
    pose = np.asarray(pose_mm, np.float64)
    moves_mm = np.abs(pose[:3, 3]).max() if pose.shape == (4, 4) else 0.0
    if LEAST_MOVE_MM[0] < moves_mm < LEAST_MOVE_MM[1]:
        text = (
            f"{name} moves by {moves_mm:.3g} mm: is its translation in metres? Multiply it by 1000"
        )
        warnings.warn(text, stacklevel=3)


def beside_gel(mesh: Mesh, pose_gel_object: FloatArray, sensor: Description) -> str:
    """Why an object cannot press on the gel: where it is, and the fix."""
    if not len(mesh.faces):
        return "the mesh has no faces: nothing can touch the gel"
    places_mm = mesh.vertices_mm @ pose_gel_object[:2, :3].T + pose_gel_object[:2, 3]
    low, high = places_mm.min(axis=0), places_mm.max(axis=0)
    width_mm, height_mm = gel_size_mm(sensor)
    if (low < (width_mm / 2, height_mm / 2)).all() and (
        high > (-width_mm / 2, -height_mm / 2)
    ).all():
        return (
            f"no pixel of {sensor.mm_per_px:g} mm has any of the object, which is "
            f"{np.ptp(places_mm, axis=0).max():.3g} mm large, over it; give mesh and pose in mm"
        )
    along = " and ".join(
        f"{axis} {start:.3g} to {stop:.3g}"
        for axis, start, stop in zip("xy", low, high, strict=True)
    )
    return (
        f"nothing of the object is over the gel of {width_mm:.3g} × {height_mm:.3g} mm: it is at "
        f"{along} mm of the gel's frame; move it by pose_gel_object, and give mesh and pose in mm"
    )


def _contact_frame(
    time_s: float,
    force_n: float,
    shear_n: Sequence[float] | FloatArray,
    torsion_n_mm: float,
    pose_gel_object: FloatArray,
) -> ContactFrame:
    shear = np.asarray(shear_n, np.float64)
    finite = np.isfinite([force_n, torsion_n_mm]).all() and np.isfinite(shear).all()
    if shear.shape != (2,) or not finite or force_n < 0:
        msg = (
            f"force_n = {force_n}, shear_n = {shear_n}: give a force into the gel of 0 N or more "
            "and two shear forces along the gel's x and y"
        )
        raise ContactError(msg)
    pose = np.asarray(pose_gel_object, np.float64)
    return ContactFrame(time_s, float(force_n), shear, float(torsion_n_mm), pose)


def _pose(given_mm: FloatArray | None, name: str) -> NDArray[np.float64]:
    """A (4, 4) pose in metres from one in mm; the identity where None."""
    pose = np.eye(4) if given_mm is None else np.array(given_mm, np.float64)
    if problem := pose_problem(pose):
        msg = f"{name} {problem}"
        raise SensorError(msg)
    warn_of_metres(pose, name)
    pose[:3, 3] /= MM_PER_M
    return pose
