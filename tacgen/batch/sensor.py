"""Pictures of many worlds at once, on a GPU or on the CPU.

Warp (Apache-2.0, 170 MB) compiles one source for both, without a display, and shares arrays with
torch, JAX, Newton, MuJoCo Warp and Isaac Lab. Taichi has had no release since July 2025, and its
fork Quadrants promises no stable interface; numba-cuda compiles for CUDA alone; torch and JAX weigh
gigabytes and have no kernels of their own for the exact solve, the meshes and the shadows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gap import GAP_GRAIN_MM
from tacgen.contact.law import ContactLaw
from tacgen.core.errors import ContactError, SensorError
from tacgen.core.optional_dependencies import require_extra
from tacgen.core.records import ContactFrame
from tacgen.sensor.gel_response import GelCourse
from tacgen.sensor.simulated import MeshLike, Sensor, as_mesh

FIELDS = ("rgb", "depth_mm", "contact_mask", "indentation_mm", "saturated", "markers_mm")


@dataclass(frozen=True, slots=True)
class BatchFrame:
    """What the sensors of all worlds show, in arrays of the library that the input came from.

    They are the sensor's own memory: what is in them is valid until its next call. Copy what you
    keep.

    Attributes
    ----------
    rgb : (N, H, W, 3) uint8
    depth_mm : (N, H, W) float32
        Indentation of the gel.
    contact_mask : (N, H, W) bool
    indentation_mm : (N,) float32
        Deepest indentation beyond first touch; 0 where nothing touches.
    saturated : (N,) bool
        Whether the gel is pressed through to its backing.
    markers_mm : (N, M, 2) float32 or None
        Places x, y of the marker dots, gel frame; None without markers.
    """

    rgb: Any
    depth_mm: Any
    contact_mask: Any
    indentation_mm: Any
    saturated: Any
    markers_mm: Any = None


class BatchSensor:
    """One GelSight-like sensor in each of N worlds; its pictures are those of :class:`Sensor`.

    Parameters
    ----------
    name, table, contact, shadows, markers, noise
        As of :class:`tacgen.Sensor`. The noise is drawn from ``seed`` and the number of the call.
    n : int
        Number of worlds.
    device : str
        ``cuda``, ``cuda:1`` … or ``cpu``.

    Raises
    ------
    SensorError
        If Warp or the device is not there, or the memory does not suffice.
    RecipeError, TableError, ContactError
        As of :class:`tacgen.Sensor`.

    Examples
    --------
    >>> import numpy as np, tacgen, trimesh
    >>> batch = tacgen.BatchSensor("digit", 2, device="cpu")
    >>> ball = batch.add_mesh(trimesh.creation.icosphere(subdivisions=4, radius=4.0))
    >>> out = batch.render_meshes([ball, ball], np.stack([np.eye(4)] * 2), [1.0, 3.0])
    >>> out.rgb.shape, bool(out.indentation_mm[0] < out.indentation_mm[1])
    ((2, 320, 240, 3), True)
    """

    def __init__(
        self,
        name: str = "gelsight",
        n: int = 1,
        device: str = "cuda",
        *,
        table: str | Path | None = None,
        contact: str | Path | ContactLaw | None = None,
        shadows: bool = False,
        markers: bool = False,
        noise: bool = False,
        seed: int = 0,
    ) -> None:
        require_extra("batch", "a batch of sensors needs", SensorError)
        if not isinstance(n, int) or n < 1:
            msg = f"n = {n}: give the number of worlds, 1 or more"
            raise SensorError(msg)
        single = Sensor(name, table, contact, shadows=shadows, markers=markers)
        self.description, self.law, self.table, self.n = (
            single.description,
            single.law,
            single.table,
            n,
        )
        from tacgen.batch import arrays
        from tacgen.batch.renderer import BatchRenderer

        self._arrays = arrays
        self._device = arrays.find_device(device)
        sigma = self.table.noise_grey if noise else 0.0
        self._renderer = BatchRenderer(
            *(self.description, self.table, n, self._device),
            shadows=shadows,
            markers=markers,
            noise_grey=sigma,
        )
        self._seed, self._calls = seed, 0
        self._gels = [GelCourse(self.law) for _ in range(n)] if self.law.effects else []

    def __repr__(self) -> str:
        return f"BatchSensor({self.description.name!r}, n={self.n}, device={str(self._device)!r})"

    def render(
        self,
        gap_mm: Any,
        force_n: Any,
        shear_n: Any = None,
        turn: Any = None,
        *,
        time_s: Any = None,
    ) -> BatchFrame:
        """The frames of objects of which the gaps to the gel at rest are known.

        Parameters
        ----------
        gap_mm : (N, H, W) float32
            Distance along z, in mm, from the gel's surface at rest (its dome included) to the
            object, as a depth camera behind the gel sees it; +inf where there is none. A distance
            for all pixels alike changes nothing.
        force_n : (N,) float32 or float64
            Force of each object into the gel.
        shear_n, turn
            Shear is not drawn yet: None, or zeros.
        time_s : (N,) or float, optional
            The worlds' clocks, for a contact law with memory (creep, hysteresis): each world's load
            goes on from its last, until ``reset``. Without it every frame is a new press.

        Raises
        ------
        SensorError, ContactError
            If an array is on another device, of another shape or type, holds NaN, or a force is
            negative.
        """
        arrays, kind = self._arrays, self._arrays.kind_of(gap_mm)
        self._refuse_shear(shear_n, turn)
        shape = (self.n, *self.description.shape_px)
        gap = arrays.as_warp(gap_mm, "gap_mm", shape, self._device, ("float32",))
        is_depth = self._ask(force_n, time_s)
        for start in self._renderer.parts():
            self._renderer.indent_gaps(gap, start, is_depth=is_depth)
            self._renderer.draw(self._noise_seed())
        return self._frame(kind)

    def render_depth(self, depth_mm: Any) -> BatchFrame:
        """The frames of indentations (N, H, W) float32, in mm, that the simulation itself gives."""
        arrays, kind = self._arrays, self._arrays.kind_of(depth_mm)
        shape = (self.n, *self.description.shape_px)
        depth = arrays.as_warp(depth_mm, "depth_mm", shape, self._device, ("float32",))
        for start in self._renderer.parts():
            self._renderer.take_depth(depth, start)
            self._renderer.draw(self._noise_seed())
        return self._frame(kind)

    def add_mesh(self, mesh: MeshLike) -> int:
        """Register a mesh, in mm, in the object's own frame; returns its index."""
        return self._renderer.add_mesh(as_mesh(mesh))

    def render_meshes(
        self,
        mesh_ids: Any,
        poses: Any,
        force_n: Any,
        shear_n: Any = None,
        turn: Any = None,
        *,
        time_s: Any = None,
    ) -> BatchFrame:
        """The frames of posed meshes, as ``Sensor.render`` draws them.

        ``mesh_ids`` (N,) int32 or int64 are what ``add_mesh`` returned; ``poses`` (N, 4, 4) float32
        or float64 lead from each object to its gel frame, in mm. What touches the gel beside the
        window carries its share of the force. The arrays that come out are of the kind of
        ``poses``. The rest is as of ``render``.
        """
        arrays, kind = self._arrays, self._arrays.kind_of(poses)
        self._refuse_shear(shear_n, turn)
        if not self._renderer.n_meshes:
            msg = "there is no mesh yet; call add_mesh first"
            raise SensorError(msg)
        n = self.n
        integers, numbers = ("int32", "int64"), ("float32", "float64")
        ids = arrays.as_warp(mesh_ids, "mesh_ids", (n,), self._device, integers)
        pose = arrays.as_warp(poses, "poses", (n, 4, 4), self._device, numbers)
        is_depth = self._ask(force_n, time_s)
        self._renderer.pose_meshes(ids, pose)
        for start in self._renderer.parts():
            self._renderer.indent_meshes(start, is_depth=is_depth)
            self._renderer.draw(self._noise_seed())
        return self._frame(kind)

    def reset(self, world_ids: Any = None) -> None:
        """Begin a new press, on a gel at rest, in some worlds; in all without ``world_ids``."""
        ids = range(self.n) if world_ids is None else np.asarray(world_ids).reshape(-1).tolist()
        for world in ids:
            if not 0 <= world < self.n:
                msg = f"world_ids has {world}; there are worlds 0 to {self.n - 1}"
                raise SensorError(msg)
            if self._gels:
                self._gels[world].begin()

    def _refuse_shear(self, shear_n: Any, turn: Any) -> None:
        for name, given in (("shear_n", shear_n), ("turn", turn)):
            if given is not None and bool(
                (np.asarray(given) if isinstance(given, list | tuple) else given != 0).any()
            ):
                msg = f"{name} is not drawn in a batch yet; leave it out, or use tacgen.Sensor"
                raise SensorError(msg)

    def _ask(self, force_n: Any, time_s: Any) -> bool:
        """Put what the law asks of each gel on the device; whether that is δ, not a volume."""
        numbers = ("float32", "float64")
        force = self._arrays.as_warp(force_n, "force_n", (self.n,), self._device, numbers)
        is_depth = self.law.law == "linear_depth"
        per_unit = 1.0 if is_depth else self.description.pixel_area_mm2
        compliance = self.law.k_depth_mm_per_n if is_depth else self.law.k_n_mm3_per_n
        factor = compliance.value if compliance is not None else 0.0
        if self.law.effects:
            asked = self._with_memory(force.numpy(), time_s)
            force, factor = (
                self._arrays.as_warp(asked, "force_n", (self.n,), self._device, numbers),
                1.0,
            )
        self._renderer.ask(force, factor / (GAP_GRAIN_MM * per_unit))
        return is_depth

    def _with_memory(self, forces_n: NDArray[Any], time_s: Any) -> list[float]:
        """The law's response of each world, on the host: effects are functions of a history."""
        if time_s is None:
            self.reset()
        times = np.broadcast_to(0.0 if time_s is None else np.asarray(time_s, float), self.n)
        nothing = np.zeros(2)
        if not (np.isfinite(forces_n).all() and (forces_n >= 0).all() and np.isfinite(times).all()):
            msg = "force_n or time_s holds a negative force or what is not finite"
            raise ContactError(msg)
        loads = []
        for gel, force, time in zip(self._gels, forces_n.tolist(), times.tolist(), strict=True):
            if gel.last_s is not None and time < gel.last_s:
                gel.begin()
            frame = ContactFrame(time, force, nothing, 0.0, np.eye(4))
            load = gel.load(frame, 0.0)
            loads.append(load.indentation_mm if load.volume_mm3 is None else load.volume_mm3)
        return [0.0 if one is None else one for one in loads]

    def _noise_seed(self) -> int:
        return (self._seed * 0x9E3779B1 + self._calls * 0x85EBCA77) % (1 << 32)

    def _frame(self, kind: str) -> BatchFrame:
        self._calls += 1
        drawn = self._renderer
        if problem := drawn.problem():
            raise ContactError(problem)
        names = FIELDS if drawn.worlds.n_markers else FIELDS[:-1]
        found = (getattr(drawn.worlds, name) for name in names)
        return BatchFrame(*(self._arrays.as_kind(one, kind) for one in found))
