"""Pictures of many worlds at once, on a GPU or on the CPU.

Warp (Apache-2.0, 490 MB) compiles one source for both, without a display, and shares arrays with
torch, JAX, Newton, MuJoCo Warp and Isaac Lab. Taichi has had no release since July 2025, and its
fork Quadrants promises no stable interface; numba-cuda compiles for CUDA alone; torch and JAX weigh
gigabytes and have no kernels of their own for the exact solve, the meshes and the shadows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.contact.gap import GAP_GRAIN_MM
from tacgen.contact.law import ContactLaw
from tacgen.core.errors import ContactError, SensorError, require_extra
from tacgen.sensor.simulated import MeshLike, Sensor, as_mesh, warn_of_metres

NUMBERS = ("int32", "int64", "float32", "float64")
FIELDS = ("rgb", "depth_mm", "contact_mask", "indentation_mm", "saturated")


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
    slides : (N,) bool
        Whether the shear asked for is more than friction holds: the object slides, and the gel
        moves no farther. ``friction`` of the contact law says how rough they are.
    markers_mm : (N, M, 2) float32 or None
        Places x, y of the marker dots, gel frame; None without markers.
    """

    rgb: Any
    depth_mm: Any
    contact_mask: Any
    indentation_mm: Any
    saturated: Any
    slides: Any
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
        if not isinstance(n, int | np.integer) or n < 1:
            msg = f"n = {n}: give the number of worlds, 1 or more"
            raise SensorError(msg)
        if not isinstance(seed, int | np.integer):
            msg = f"seed = {seed!r}: give a whole number"
            raise SensorError(msg)
        single = Sensor(name, table, contact, shadows=shadows, markers=markers)
        self.description, self.law, self.table = single.description, single.law, single.table
        self.n = n = int(n)
        from tacgen.batch import arrays
        from tacgen.batch.gels import Gels
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
        self._seed, self._calls = int(seed), 0
        self._gels = Gels(self.description, self.law, n, self._device, self._renderer.part)
        self._is_depth = self.law.law == "linear_depth"

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
        force_n : (N,)
            Force of each object into the gel.
        shear_n, turn
            As of ``render_meshes``; None or zeros, since shear moves the object, and a gap map does
            not tell what then lies over the gel.
        time_s : (N,) or float, optional
            The worlds' clocks, where gels remember: the effects of a contact law (creep,
            hysteresis), and the shear. Each world goes on from its last frame, until ``reset``.
            Without it every frame is a new press.

        Raises
        ------
        SensorError, ContactError
            If an array is on another device, of another shape or type, holds NaN, or a force is
            negative.
        """
        arrays, kind = self._arrays, self._arrays.kind_of(gap_mm)
        shape = (self.n, *self.description.shape_px)
        gap = arrays.as_warp(gap_mm, "gap_mm", shape, self._device, ("float32",))
        with self._refused_as_if_not_called():
            self._ask(force_n, shear_n, turn, time_s, has_meshes=False)
            for start in self._renderer.parts():
                self._renderer.indent_gaps(gap, start, is_depth=self._is_depth)
                self._renderer.draw(self._noise_seed())
            return self._frame(kind)

    def render_depth(self, depth_mm: Any) -> BatchFrame:
        """The frames of indentations (N, H, W) float32, in mm, that the simulation itself gives."""
        arrays, kind = self._arrays, self._arrays.kind_of(depth_mm)
        shape = (self.n, *self.description.shape_px)
        depth = arrays.as_warp(depth_mm, "depth_mm", shape, self._device, ("float32",))
        self._renderer.release_markers()
        self._gels.slides.zero_()
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
        window carries its share of the force. ``shear_n`` (N, 2) are the forces of the objects
        along the gel's x and y, ``turn`` (N,) their moments about its normal, N·mm. The arrays
        that come out are of the kind of ``poses``. The rest is as of ``render``.
        """
        arrays, kind = self._arrays, self._arrays.kind_of(poses)
        if not self._renderer.n_meshes:
            msg = "there is no mesh yet; call add_mesh first"
            raise SensorError(msg)
        ids = arrays.as_warp(mesh_ids, "mesh_ids", (self.n,), self._device, ("int32", "int64"))
        pose = arrays.as_warp(poses, "poses", (self.n, 4, 4), self._device, NUMBERS)
        if not self._calls:
            places = pose.numpy()
            farthest = np.abs(places[:, :3, 3]).max(axis=1).argmax()
            warn_of_metres(places[farthest], "poses: no object")
        drawn = self._renderer
        with self._refused_as_if_not_called():
            drawn.pose_meshes(ids, pose)
            gels = self._ask(force_n, shear_n, turn, time_s)
            for start in drawn.parts():
                drawn.indent_meshes(start, is_depth=self._is_depth)
                if gels is not None:
                    drawn.shear_meshes(gels)
                    drawn.indent_meshes(start, is_depth=self._is_depth)
                drawn.draw(self._noise_seed())
            return self._frame(kind)

    def reset(self, world_ids: Any = None) -> None:
        """Begin a new press, on a gel at rest, in some worlds; in all without ``world_ids``.

        They are indices, or a mask (N,) of bool.
        """
        ids = np.arange(self.n) if world_ids is None else self._arrays.on_host(world_ids)
        if ids.dtype == bool and ids.shape == (self.n,):
            ids = np.flatnonzero(ids)
        if ids.dtype.kind not in "iu" and ids.size:
            msg = f"world_ids is of {ids.dtype}; give indices of worlds, or a mask of {self.n} bool"
            raise SensorError(msg)
        ids = ids.reshape(-1).astype(int)
        for world in ids[(ids < 0) | (ids >= self.n)]:
            msg = f"world_ids has {world}; there are worlds 0 to {self.n - 1}"
            raise SensorError(msg)
        self._gels.begin(ids)

    @contextmanager
    def _refused_as_if_not_called(self) -> Iterator[None]:
        """A call that raises leaves the gels' histories, and no complaint, for the next."""
        history = self._gels.history()
        try:
            yield
        except Exception:
            self._renderer.problem()
            self._gels.take_back(history)
            raise

    def _ask(
        self, force_n: Any, shear_n: Any, turn: Any, time_s: Any, *, has_meshes: bool = True
    ) -> Any:
        """Put what the law asks of each gel on the device; the gels, where they are sheared."""
        n, law, gels, drawn = self.n, self.law, self._gels, self._renderer

        def read(given: Any, name: str, *shape: int) -> Any:
            return self._arrays.as_warp(given, name, shape, self._device, NUMBERS)

        force = read(force_n, "force_n", n)
        pulls, times = np.zeros((n, 3)), None
        if shear_n is not None:
            pulls[:, :2] = read(shear_n, "shear_n", n, 2).numpy()
        if turn is not None:
            pulls[:, 2] = read(turn, "turn", n).numpy()
        if time_s is not None:
            times = read(time_s, "time_s", n).numpy().astype(float)
        rows = pulls if times is None else np.column_stack([pulls, times])
        if (wrong := np.flatnonzero(~np.isfinite(rows).all(axis=1))).size:
            msg = f"world {wrong[0]}: shear_n, turn or time_s is not finite"
            raise ContactError(msg)
        is_sheared = bool(pulls.any()) or (times is not None and gels.may_be_sheared)
        if is_sheared and not has_meshes:
            msg = "shear moves the object, which a gap map does not tell; give render_meshes meshes"
            raise SensorError(msg)
        compliance = law.k_depth_mm_per_n if self._is_depth else law.k_n_mm3_per_n
        factor = compliance.value if compliance is not None else 0.0
        per_unit = GAP_GRAIN_MM * (1.0 if self._is_depth else self.description.pixel_area_mm2)
        drawn.release_markers()
        gels.at(times)
        drawn.ask(force, factor / per_unit)
        if gels.is_plain and not is_sheared:
            return None
        if problem := drawn.problem():
            raise ContactError(problem)
        force_on_host: Any = force.numpy().astype(float)
        along_n: Any = pulls[:, :2]
        if not gels.is_plain:
            asked, along_n = gels.responses(force_on_host, along_n, times)
            drawn.ask(self._arrays.upload(asked, self._device), 1.0 / per_unit)
        if not is_sheared:
            return None
        return gels.pull(force_on_host, pulls, along_n, keeps=times is not None)

    def _noise_seed(self) -> int:
        return (self._seed * 0x9E3779B1 + self._calls * 0x85EBCA77) % (1 << 32)

    def _frame(self, kind: str) -> BatchFrame:
        drawn = self._renderer
        if problem := drawn.problem():
            raise ContactError(problem)
        self._calls += 1
        worlds = drawn.worlds
        found = [getattr(worlds, name) for name in FIELDS] + [self._gels.slides]
        found += [worlds.markers_mm] if worlds.n_markers else []
        return BatchFrame(*(self._arrays.as_kind(one, kind) for one in found))
