"""A batch on the CPU: the pads of single sensors, in as many threads as there are cores."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.batch.arrays import as_kind, as_numpy, check_memory, free_bytes
from tacgen.batch.gels import Loads
from tacgen.contact.gap import checked_mesh
from tacgen.contact.indenter import Imprint
from tacgen.core.errors import ContactError
from tacgen.core.processes import available_cores
from tacgen.core.records import Mesh, rng_of
from tacgen.sensor.tactile_pad import TactilePad

PAD_BYTES_PER_PX = 150
"""Memory of one pad: maps of gaps, heights and grey levels, measured at 640 × 480."""
WRONG_MAP = "the map holds NaN or an infinity; only a gap may be +inf: where there is no object"

Press = Callable[[TactilePad, int], Imprint]


class ThreadWorlds:
    """N worlds of one sensor, drawn by one pad a core; a pad's frame does not depend on the last.

    ``make_pad`` makes a pad; with ``seed`` the camera's noise is drawn, anew in every call.
    """

    def __init__(self, make_pad: Callable[[], TactilePad], n: int, seed: int | None) -> None:
        first = make_pad()
        self._sensor, self._seed, self._n = first.sensor, seed, n
        height, width = self._sensor.shape_px
        cores = min(n, available_cores())
        at_work = PAD_BYTES_PER_PX * height * width * cores
        check_memory(n, (height, width), "cpu", free_bytes(), at_work)
        self._pads = [first, *(make_pad() for _ in range(cores - 1))]
        self._pool = ThreadPoolExecutor(cores)
        self._meshes = list[Mesh]()
        self._before: list[Imprint | None] = [None] * n
        self._rgb = np.zeros((n, height, width, 3), np.uint8)
        self._depth_mm = np.zeros((n, height, width), np.float32)
        self._contact_mask = np.zeros((n, height, width), bool)
        self._indentation_mm, self._saturated = np.zeros(n, np.float32), np.zeros(n, bool)
        self._shares = np.zeros(n)
        self._markers_mm: NDArray[np.float32] | None = None
        if first.draws_markers:
            self._markers_mm = np.zeros((n, len(first.marker_rest_mm), 2), np.float32)

    def read(
        self, array: Any, name: str, shape: tuple[int, ...], dtypes: tuple[str, ...]
    ) -> NDArray[Any]:
        """An array of any library."""
        return as_numpy(array, name, shape, dtypes)

    small = read

    def out(self, array: NDArray[Any], kind: str) -> Any:
        """An array of the host as one of that library."""
        return as_kind(array, kind)

    def frames(self, kind: str) -> dict[str, Any]:
        """The worlds' last frames, as arrays of that library."""
        found: dict[str, NDArray[Any]] = {
            "rgb": self._rgb,
            "depth_mm": self._depth_mm,
            "contact_mask": self._contact_mask,
            "indentation_mm": self._indentation_mm,
            "saturated": self._saturated,
        }
        if self._markers_mm is not None:
            found["markers_mm"] = self._markers_mm
        return {name: as_kind(array, kind) for name, array in found.items()}

    def shares(self) -> NDArray[np.float64]:
        """The part of each world's pressure that acts in the window, (N,); NaN without contact."""
        return self._shares

    @property
    def n_meshes(self) -> int:
        """How many meshes there are."""
        return len(self._meshes)

    def add_mesh(self, mesh: Mesh) -> int:
        """The index of a mesh that worlds may then hold, in mm."""
        checked_mesh(mesh.vertices_mm, mesh.faces, np.eye(4))
        self._meshes.append(mesh)
        return len(self._meshes) - 1

    def draw_gaps(self, gap_mm: NDArray[np.float32], loads: Loads, call: int) -> None:
        """The frames of gap maps (N, H, W)."""

        def press(pad: TactilePad, world: int) -> Imprint:
            gap = gap_mm[world]
            if not gap.min() > -np.inf:
                msg = f"world {world}: {WRONG_MAP}"
                raise ContactError(msg)
            return pad.indenter.indent_map(gap, loads.of(world))

        self._draw(press, np.arange(self._n), call)

    def draw_depths(self, depth_mm: NDArray[np.float32], call: int) -> None:
        """The frames of indentations (N, H, W)."""

        def press(pad: TactilePad, world: int) -> Imprint:
            if not np.isfinite(depth_mm[world]).all():
                msg = f"world {world}: {WRONG_MAP}"
                raise ContactError(msg)
            return pad.indenter.known(depth_mm[world])

        self._draw(press, np.arange(self._n), call)

    def draw_meshes(
        self, ids: NDArray[np.int64], poses: NDArray[np.float64], loads: Loads, call: int
    ) -> None:
        """The frames of meshes at poses (N, 4, 4), pulled where the loads do."""
        before = [None if new else one for new, one in zip(loads.is_new, self._before, strict=True)]
        after = list(before)

        def press(pad: TactilePad, world: int) -> Imprint:
            mesh, load = self._meshes[ids[world]], loads.of(world)
            imprint = pad.press(mesh, poses[world], load, before[world])
            after[world] = imprint
            return imprint

        self._draw(press, np.argsort(ids, kind="stable"), call)
        self._before = after if loads.keeps else [None] * self._n

    def _draw(self, press: Press, order: NDArray[np.int64], call: int) -> None:
        """Press and draw all worlds; ``order`` puts those together that share what a pad keeps."""

        def work(pad: TactilePad, worlds: NDArray[np.int64]) -> None:
            for world in worlds.tolist():
                self._show(pad, press(pad, world), world, call)

        parts = np.array_split(order, len(self._pads))
        found = [self._pool.submit(work, *one) for one in zip(self._pads, parts, strict=True)]
        wait(found)  # all of them, also where one raises: the next call has the same pads
        for one in found:
            one.result()

    def _show(self, pad: TactilePad, imprint: Imprint, world: int, call: int) -> None:
        top, bottom, left, right = imprint.window
        depth_mm = self._depth_mm[world]
        depth_mm.fill(0.0)
        depth_mm[top:bottom, left:right] = imprint.depth_mm
        np.greater(depth_mm, 0.0, out=self._contact_mask[world])
        self._indentation_mm[world] = imprint.indentation_mm
        self._saturated[world] = imprint.saturated
        touches = imprint.depth_mm.any() or imprint.beside_depth_mm.any()
        self._shares[world] = imprint.share if touches else np.nan
        rng = None
        if self._seed is not None:
            rng = rng_of(self._seed, call, world)
        pad.image(imprint, rng=rng, rgb=self._rgb[world])
        if self._markers_mm is not None:
            self._markers_mm[world] = pad.markers_mm(imprint)
