"""Pictures of many worlds at once: on the CPU by the pads of ``Sensor``, on a GPU by Warp.

Warp (Apache-2.0, 490 MB) draws without a display, and shares arrays with torch, JAX, Newton, MuJoCo
Warp and Isaac Lab. Taichi has had no release since July 2025, and its fork Quadrants promises no
stable interface; torch and JAX weigh gigabytes and have no kernels of their own for the exact
solve, the meshes and the shadows.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.batch.arrays import NUMBERS, kind_of, on_host
from tacgen.batch.gels import Gels, Loads
from tacgen.contact.gap import pose_problem
from tacgen.contact.law import ContactLaw
from tacgen.core.errors import ContactError, SensorError, require_extra
from tacgen.sensor.simulated import MeshLike, Sensor, as_mesh, warn_of_metres
from tacgen.sensor.tactile_pad import TactilePad

MOST_FORCE_N = 1e300  # beyond it a number is as good as infinite


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
    force_n, total_force_n : (N, 3) float64
        Force along x, y and into the gel, N: the share of the contact that the picture shows, and
        all of it, beside the window too. 0 where nothing touches, NaN where the indentation was
        given.
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
    force_n: Any
    total_force_n: Any
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
    ((2, 640, 480, 3), True)
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
        if not isinstance(n, int | np.integer) or n < 1:
            msg = f"n = {n}: give the number of worlds, 1 or more"
            raise SensorError(msg)
        if not isinstance(seed, int | np.integer):
            msg = f"seed = {seed!r}: give a whole number"
            raise SensorError(msg)
        single = Sensor(name, table, contact, shadows=shadows, markers=markers)
        self.description, self.law, self.table = single.description, single.law, single.table
        self.n, self._calls, self._device = int(n), 0, str(device)
        self._gels, self._n_meshes = Gels(self.law, self.n), 0
        drawn: dict[str, Any] = {"shadows": shadows, "markers": markers}
        drawn_seed = int(seed) if noise and self.table.noise_grey > 0 else None
        self._worlds: Any
        if self._device == "cpu":
            from tacgen.batch.threads import ThreadWorlds

            make_pad = partial(TactilePad, self.description, self.table, **drawn)
            self._worlds = ThreadWorlds(make_pad, self.n, drawn_seed)
        else:
            require_extra("batch", f"device = {self._device!r} needs", SensorError)
            from tacgen.batch.warp_worlds import WarpWorlds, find_device

            self._worlds = WarpWorlds(
                *(self.description, self.table, self.n, find_device(device)),
                seed=drawn_seed,
                **drawn,
            )

    def __repr__(self) -> str:
        return f"BatchSensor({self.description.name!r}, n={self.n}, device={self._device!r})"

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
        gap = self._map(gap_mm, "gap_mm")
        with self._refused_as_if_not_called():
            loads = self._loads(force_n, shear_n, turn, time_s, has_meshes=False)
            self._worlds.draw_gaps(gap, loads, self._calls)
        return self._frame(kind_of(gap_mm), loads)

    def render_depth(self, depth_mm: Any) -> BatchFrame:
        """The frames of indentations (N, H, W) float32, in mm, that the simulation itself gives."""
        self._worlds.draw_depths(self._map(depth_mm, "depth_mm"), self._calls)
        return self._frame(kind_of(depth_mm))

    def add_mesh(self, mesh: MeshLike) -> int:
        """Register a mesh, in mm, in the object's own frame; returns its index."""
        solid = as_mesh(mesh)
        if not len(solid.faces):
            msg = "the mesh has no faces: nothing can touch the gel"
            raise ContactError(msg)
        self._n_meshes += 1
        return int(self._worlds.add_mesh(solid))

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
        if not self._n_meshes:
            msg = "there is no mesh yet; call add_mesh first"
            raise SensorError(msg)
        n, small = self.n, self._worlds.small
        ids = small(mesh_ids, "mesh_ids", (n,), ("int32", "int64")).astype(np.int64)
        places = small(poses, "poses", (n, 4, 4), NUMBERS).astype(np.float64)
        if not self._calls:
            farthest = np.abs(places[:, :3, 3]).max(axis=1).argmax()
            warn_of_metres(places[farthest], "poses: no object")
        for world in np.flatnonzero((ids < 0) | (ids >= self._n_meshes))[:1]:
            msg = f"world {world}: mesh_ids has an index that add_mesh has not returned"
            raise ContactError(msg)
        for world, pose in enumerate(places):
            if problem := pose_problem(pose):
                msg = f"world {world}: the pose {problem}"
                raise ContactError(msg)
        with self._refused_as_if_not_called():
            loads = self._loads(force_n, shear_n, turn, time_s)
            self._worlds.draw_meshes(ids, places, loads, self._calls)
        return self._frame(kind_of(poses), loads)

    def reset(self, world_ids: Any = None) -> None:
        """Begin a new press, on a gel at rest, in some worlds; in all without ``world_ids``.

        They are indices, or a mask (N,) of bool.
        """
        ids = np.arange(self.n) if world_ids is None else on_host(world_ids)
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
        """A call that raises leaves the gels' histories for the next."""
        history = self._gels.history()
        try:
            yield
        except Exception:
            self._gels.take_back(history)
            raise

    def _map(self, given: Any, name: str) -> Any:
        shape = (self.n, *self.description.shape_px)
        return self._worlds.read(given, name, shape, ("float32",))

    def _loads(
        self, force_n: Any, shear_n: Any, turn: Any, time_s: Any, *, has_meshes: bool = True
    ) -> Loads:
        """What the law asks of each gel."""
        n, small = self.n, self._worlds.small
        force = small(force_n, "force_n", (n,), NUMBERS).astype(np.float64)
        for world in np.flatnonzero(~((force >= 0) & (force < MOST_FORCE_N)))[:1]:
            msg = (
                f"world {world}: force_n is negative or not finite; give a force into the gel of "
                "0 N or more"
            )
            raise ContactError(msg)
        pulls, times = np.zeros((n, 3)), None
        if shear_n is not None:
            pulls[:, :2] = small(shear_n, "shear_n", (n, 2), NUMBERS)
        if turn is not None:
            pulls[:, 2] = small(turn, "turn", (n,), NUMBERS)
        if time_s is not None:
            times = small(time_s, "time_s", (n,), NUMBERS).astype(np.float64)
        rows = pulls if times is None else np.column_stack([pulls, times])
        if (wrong := np.flatnonzero(~np.isfinite(rows).all(axis=1))).size:
            msg = f"world {wrong[0]}: shear_n, turn or time_s is not finite"
            raise ContactError(msg)
        loads = self._gels.loads(force, pulls, times)
        if loads.is_sheared and not has_meshes:
            msg = "shear moves the object, which a gap map does not tell; give render_meshes meshes"
            raise SensorError(msg)
        return loads

    def _frame(self, kind: str, loads: Loads | None = None) -> BatchFrame:
        self._calls += 1
        out, shown = self._worlds.out, self._worlds.shares()[:, None]
        slides, force_n = np.zeros(self.n, bool), np.full((self.n, 3), np.nan)
        if loads is not None:
            slides, force_n = loads.slides, np.column_stack([loads.pulls[:, :2], loads.force_n])
            force_n = np.where(np.isnan(shown), 0.0, force_n)
        return BatchFrame(
            **self._worlds.frames(kind),
            force_n=out(np.nan_to_num(shown) * force_n, kind),
            total_force_n=out(force_n, kind),
            slides=out(slides, kind),
        )
