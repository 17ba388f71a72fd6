"""The memory of a batch, and the order in which its kernels run."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import warp as wp

from tacgen.batch import kernels as k
from tacgen.batch import shear_kernels
from tacgen.batch.arrays import free_bytes
from tacgen.contact.gap import (
    FIRST_ROWS,
    GAP_GRAIN_MM,
    NO_OBJECT,
    ROTATION_TOLERANCE,
    Surround,
    checked_mesh,
)
from tacgen.contact.gel import gel_map_mm
from tacgen.contact.raster import CellMesh, cut_mesh
from tacgen.contact.shear import DILATION_DECAY_PER_MM2, DILATION_GAIN, marker_grid_mm
from tacgen.core.errors import ContactError, SensorError, TableError
from tacgen.core.records import Markers, Mesh
from tacgen.core.records import Sensor as Description
from tacgen.core.types import FloatArray
from tacgen.optics import shade
from tacgen.optics.deform import (
    FINAL_SIGMA_MM,
    FIRM_CONTACT,
    NEGLIGIBLE_MM,
    PYRAMID_SIGMA_MM,
    Deformer,
)
from tacgen.optics.effects import with_cast_shadows
from tacgen.optics.effects.shadow import DEFAULT_STRENGTH, PENUMBRA_MM, SHADOW
from tacgen.optics.image_models import Quadratic, Response
from tacgen.optics.markers import INK_TRANSMISSION
from tacgen.optics.noise import CameraNoise
from tacgen.optics.render import Shader
from tacgen.optics.smooth import Gaussian
from tacgen.optics.table import LookupTable
from tacgen.sensor.tactile_pad import FIELD_POINTS

CUDA_LANES, CUDA_BLOCK, CUDA_CELL = 64, 256, 32
"""Threads on a row, on a world and on a cell of a mesh; one on the CPU."""
CUDA_PART, CPU_PART = 256, 4
"""Worlds that are worked on at a time: on a CPU their maps stay in its cache."""
LONGEST_KERNEL, FLATTEST_SLOPE = 64, 1e-3
MOST_COLUMNS = 42  # of markers, so that no row of pixels meets more than the kernel keeps

WRONG = (
    "the map holds NaN or an infinity; only a gap may be +inf: where there is no object",
    "force_n is negative or not finite; give a force into the gel of 0 N or more",
    "the pose is no rotation and translation; give object to gel frame, in mm, not transposed",
    "mesh_ids has an index that add_mesh has not returned",
)
"""What each place of ``wrong`` in the kernels means."""


def undrawable(sensor: Description, table: LookupTable, *, markers: bool) -> str:
    """Why pictures of a sensor cannot be drawn in batches; empty if they can."""
    others, model = [name for name in table.effects if name != SHADOW.name], table.image_model
    n_columns = sensor.markers.columns if markers and sensor.markers else 0
    if others:
        return f"a batch draws no optical effect but shadows; the table has {', '.join(others)}"
    if not isinstance(model, Quadratic | Response):
        return f"a batch cannot draw the image model {model.kind!r} yet"
    if n_columns > MOST_COLUMNS:
        return f"a batch draws up to {MOST_COLUMNS} columns of markers, the sensor has {n_columns}"
    if len(Gaussian(max(PYRAMID_SIGMA_MM) / sensor.mm_per_px).kernel) > LONGEST_KERNEL:
        return f"pixels of {sensor.mm_per_px:g} mm are too small for a batch"
    return ""


class BatchRenderer:
    """Draws worlds of one sensor on one device, a part of the batch at a time."""

    def __init__(
        self,
        sensor: Description,
        table: LookupTable,
        n: int,
        device: wp.Device,
        *,
        shadows: bool,
        markers: bool,
        noise_grey: float = 0.0,
        keeps_grey: bool = False,
    ) -> None:
        if problem := undrawable(sensor, table, markers=markers):
            msg = f"{problem}; use tacgen.Sensor"
            raise TableError(msg)
        self.n, self.device, self._sensor = n, device, sensor
        self.height, self.width = sensor.shape_px
        is_cuda = device.is_cuda
        self._lanes, self._block = (CUDA_LANES, CUDA_BLOCK) if is_cuda else (1, 1)
        self._surround, self._cut = Surround(sensor), list[CellMesh]()
        self._meshes: Any = None
        self.part = self._fitting_part(CUDA_PART if is_cuda else CPU_PART, shadows=shadows)
        self.worlds = self._allocate()
        if keeps_grey:
            self.worlds.grey = self._zeros((n, self.height, self.width, 3), wp.float32)
        self._prepare_optics(table, noise_grey, shadows=shadows)
        self._prepare_pyramid(sensor.mm_per_px)
        if markers and sensor.markers is not None:
            self._prepare_markers(sensor.markers)
        self._no_beside = self._zeros((self.part, 0), wp.int32)

    def _put(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _zeros(self, shape: Any, dtype: Any, value: Any = 0) -> wp.array:
        return wp.full(shape, value, dtype=dtype, device=self.device)

    def _fitting_part(self, most: int, *, shadows: bool) -> int:
        """How many worlds to work on at a time; a ``SensorError`` if the results do not fit."""
        pixels = self.height * self.width
        each, at_work = 8 * pixels + 200, (38 + (20 if shadows else 0)) * pixels
        free = free_bytes(self.device)
        fit = max(0, (free - at_work) // each)
        if self.n > fit:
            msg = (
                f"n = {self.n}: pictures of {self.width} × {self.height} px of so many worlds need "
                f"{self.n * each / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free on {self.device}: "
                f"{fit} worlds fit; give n = {fit}, and more than one batch"
            )
            raise SensorError(msg)
        return int(max(1, min(self.n, most, (free - self.n * each) // at_work)))

    def _allocate(self) -> Any:
        n, b, h, w, zeros = self.n, self.part, self.height, self.width, self._zeros
        p = k.Worlds()
        p.lanes, p.mm_per_px, p.grain_mm = self._lanes, self._sensor.mm_per_px, GAP_GRAIN_MM
        p.wrong, p.asked = zeros(len(WRONG), wp.int32, n), zeros(n, wp.float64)
        p.rgb, p.depth_mm = zeros((n, h, w, 3), wp.uint8), zeros((n, h, w), wp.float32)
        p.contact_mask, p.saturated = zeros((n, h, w), wp.bool, False), zeros(n, wp.bool, False)
        p.beside_mm3 = zeros(n, wp.float64)
        p.indentation_mm, p.grains = zeros(n, wp.float32), zeros((b, h, w), wp.int32)
        p.zero_mm, p.delta, p.deepest = (zeros(b, wp.float64) for _ in range(3))
        p.deepest_mm, p.relief_mm = zeros(b, wp.float32), zeros(b, wp.float32)
        p.patches, p.changed = (wp.zeros(b, dtype=wp.vec4i, device=self.device) for _ in range(2))
        p.spans, p.image = zeros((b, h, 2), wp.int32), zeros((b, h, w, 3), wp.float32)
        rest_mm = np.asarray(gel_map_mm(self._sensor), np.float32)
        p.rest_mm, p.surface = self._put(rest_mm, wp.float32), zeros((b, h, w), wp.float32)
        p.height_mm = self._put(np.broadcast_to(rest_mm, (b, h, w)), wp.float32)
        return p

    def _prepare_optics(self, table: LookupTable, noise_grey: float, *, shadows: bool) -> None:
        sensor, shape, p = self._sensor, self._sensor.shape_px, self.worlds
        shader = Shader(table, shadows=shadows, leds=sensor.leds)
        effects = dict(with_cast_shadows(table.effects) if shadows else table.effects)
        shadow = effects.get(SHADOW.name)
        rest_mm = np.ascontiguousarray(gel_map_mm(sensor), np.float32)
        whole = (0, shape[0], 0, shape[1])
        lit, rgb = np.empty((*shape, 3), np.float32), np.empty((*shape, 3), np.uint8)
        shader.light(rest_mm, whole, lit)
        image = lit.copy()
        shader.finish(rest_mm, whole, image)
        shade.quantize(image, whole, shade.whole_spans(whole), rgb)
        p.lit_at_rest, p.image_at_rest = self._put(lit, wp.float32), self._put(image, wp.float32)
        p.rgb_at_rest, p.noise_grey = self._put(rgb, wp.uint8), noise_grey
        p.quantiles = self._put(CameraNoise(noise_grey).quantiles, wp.float32)
        self._gel_mm = self._put(gel_map_mm(sensor), wp.float64)
        self._table = self._table_on_device(table, shape)
        self._lights = self._lights_on_device(table, shadow)

    def _table_on_device(self, table: LookupTable, shape: tuple[int, int]) -> Any:
        model, ready = table.image_model, k.Table()
        contact, rest_mm = np.zeros((2, 12), np.float32), np.zeros((1, 1), np.float32)
        if isinstance(model, Quadratic):
            nodes = shade.packed_nodes(model.coefficients)
            ready.n_slope, ready.n_direction = nodes.shape[0], nodes.shape[1] - 1
            ready.interpolates = model.interpolation == "linear" and nodes.shape[0] > 1
        elif isinstance(model, Response):  # else it is refused
            nodes = shade.packed_response(model.response)
            ready.node_rows, ready.node_columns, ready.n_slope = nodes.shape[:3]
            ready.n_direction, ready.is_response, ready.interpolates = (
                nodes.shape[3] - 1,
                True,
                True,
            )
            contact = np.zeros((nodes.shape[0], 12 * nodes.shape[1]), np.float32)
            rest_mm = np.full(shape, -np.inf, np.float32)  # no pixel is deeper
            if model.contact is not None:
                contact = shade.packed_contact(model.contact.change)
                rest_mm = model.contact.rest_mm(shape, table.mm_per_px)
                ready.contact_depth_mm = model.contact.depth_mm
        ready.nodes = self._put(nodes.reshape(-1), wp.float32)
        ready.per_slope = (ready.n_slope - 1) / table.max_slope_rad
        ready.per_direction = ready.n_direction / (2 * math.pi)
        ready.contact = self._put(contact, wp.float32)
        ready.contact_rest_mm = self._put(rest_mm, wp.float32)
        ready.background = self._put(table.background, wp.float32)
        return ready

    def _lights_on_device(self, table: LookupTable, shadow: Any) -> Any:
        """The lights as ``optics.effects.shadow.cast_shadow`` takes them."""
        ready, b, h, w = k.Lights(), self.part, self.height, self.width
        if shadow is None:
            return ready
        values = SHADOW.prepare(table, self._sensor.leds, **shadow)
        rows, shares = [], []
        for (x, y, z), rgb in values["leds"]:
            flat = math.hypot(x, y)
            if flat < 1e-6:
                continue
            is_turned = abs(y) < abs(x)
            main, across = (x, y) if is_turned else (y, x)
            rise = abs(z) / flat
            rise_mm = rise * table.mm_per_px * flat / abs(main)
            rows.append((is_turned, main < 0, across / abs(main), rise_mm, rise))
            shares.append(shadow.get("strength", DEFAULT_STRENGTH) * np.asarray(rgb))
        turned, down, across_px, rises_mm, slopes = zip(*rows, strict=True)
        total = np.maximum(np.sum([rgb for _, rgb in values["leds"]], axis=0), 1e-9)
        ready.n = len(rows)
        ready.is_turned, ready.is_downwards = self._put(turned, wp.int32), self._put(down, wp.int32)
        ready.across_px = self._put(across_px, wp.float32)
        ready.rise_mm = self._put(rises_mm, wp.float32)
        ready.share = self._put(np.array(shares) / total, wp.float32)
        ready.unlit = self._put(values["unlit"], wp.float32)
        ready.per_depth_px = 1.0 / (max(min(slopes), FLATTEST_SLOPE) * table.mm_per_px)
        ready.per_mm = 1.0 / PENUMBRA_MM
        ready.turned_mm = self._zeros((b, w, h), wp.float32)
        ready.hidden = self._zeros((b, ready.n, h * w), wp.float32)
        ready.met = self._zeros((b, ready.n, 2, max(h, w) + 2), wp.float32)
        return ready

    def _prepare_markers(self, markers: Markers) -> None:
        p, places_mm = self.worlds, marker_grid_mm(self._sensor)
        p.n_markers, p.marker_radius_px = len(places_mm), markers.radius_mm / self._sensor.mm_per_px
        p.markers_at_rest_mm = self._put(places_mm, wp.float32)
        p.markers_mm = self._zeros((self.n, len(places_mm), 2), wp.float32)
        p.sheared_mm = self._zeros((self.n, len(places_mm), 2), wp.float32)

    def release_markers(self) -> None:
        """No shear has moved the markers."""
        if self.worlds.n_markers:
            self.worlds.sheared_mm.zero_()

    def place_markers(self, places_mm: Sequence[FloatArray | None]) -> None:
        """Where those of the first worlds are, (M, 2), for ``draw`` without ``moves_markers``."""
        self.worlds.markers_mm[: len(places_mm)].assign(np.asarray(places_mm, np.float32))

    def _prepare_pyramid(self, mm_per_px: float) -> None:
        """The kernel, halvings, alignment and reach of every Gaussian, and its memory."""
        reach, self._margin = 1, Deformer(mm_per_px).reach_px + 1
        self._stages = []
        for sigma_mm in (*PYRAMID_SIGMA_MM, FINAL_SIGMA_MM):
            blur = Gaussian(sigma_mm / mm_per_px)
            reach += blur.reach_px
            margin, halvings = min(reach, self._margin), blur.factor.bit_length() - 1
            self._stages.append((self._put(blur.kernel, wp.float32), halvings, blur.factor, margin))
        self._levels, (h, w) = [self.worlds.surface], (self.height, self.width)
        for _ in range(2):
            h, w = (h + 1) // 2 + 4, (w + 1) // 2 + 4
            self._levels.append(self._zeros((self.part, h, w), wp.float32))
        self._along = self._zeros((self.part, self.height + 8, self.width + 8), wp.float32)

    # Launches ------------------------------------------------------------------------------------

    def _launch(self, kernel: Any, *dim: int, inputs: Any, block: int = 0) -> None:
        block = block or self._block
        wp.launch(kernel, dim=dim, inputs=inputs, device=self.device, block_dim=block)

    def _rows(self, kernel: Any, *inputs: Any) -> None:
        """A kernel for every row of the worlds at work."""
        self._launch(kernel, self._count, self.height, self._lanes, inputs=inputs)

    def _each(self, kernel: Any, *inputs: Any) -> None:
        """A kernel of one thread for each of the worlds at work."""
        self._launch(kernel, self._count, inputs=inputs)

    def _blocks(self, kernel: Any, *inputs: Any) -> None:
        """A kernel of one block of threads for each of the worlds at work."""
        self._launch(kernel, self._count, self._block, inputs=inputs)

    def parts(self, n: int | None = None) -> Iterator[int]:
        """The first world of each part of the batch, which is then at work; of the first ``n``."""
        n = self.n if n is None else n
        for start in range(0, n, self.part):
            self._count = min(self.part, n - start)
            self.worlds.start = start
            yield start

    def ask(self, force_n: wp.array, factor: float) -> None:
        """What the law asks of each gel by its force: volume in pixels × grains, or δ in grains."""
        inputs = force_n, wp.float64(factor), self.worlds
        self._launch(k.CHECK_FORCE[force_n.dtype], self.n, inputs=inputs)

    def problem(self) -> str:
        """What is wrong with the input of the last frames; empty if nothing is."""
        worlds = self.worlds.wrong.numpy()
        found = [f"world {w}: {text}" for w, text in zip(worlds, WRONG, strict=True) if w < self.n]
        if found:
            self.worlds.wrong.fill_(self.n)
        return found[0] if found else ""

    # Meshes --------------------------------------------------------------------------------------

    @property
    def n_meshes(self) -> int:
        """How many meshes there are."""
        return len(self._cut)

    def add_mesh(self, mesh: Mesh) -> int:
        """The index of a mesh that worlds may then hold, in mm."""
        vertices, faces, _ = checked_mesh(mesh.vertices_mm, mesh.faces, np.eye(4))
        if not len(faces):
            msg = "the mesh has no faces: nothing can touch the gel"
            raise ContactError(msg)
        self._cut.append(cut_mesh(vertices, faces))
        self._meshes = None
        return len(self._cut) - 1

    def _prepare_meshes(self) -> Any:
        """All meshes one after the other, cut into cells, and the memory for their gaps."""
        starts = np.cumsum([[0, 0, 0], *([len(one.vertices_mm), len(one.faces), len(one.spheres_mm)]
                                         for one in self._cut)], axis=0)  # fmt: skip
        self._most_cells = int(np.diff(starts[:, 2]).max())
        rows = list(zip(self._cut, starts, strict=False))
        m, b, surround = k.Meshes(), self.part, self._surround
        m.vertices_mm = self._put(np.concatenate([c.vertices_mm for c in self._cut]), wp.float64)
        m.faces = self._put(np.concatenate([c.faces + at[0] for c, at in rows]), wp.int32)
        first = [c.first[:-1, 1] + at[1] for c, at in rows]
        m.first = self._put(np.concatenate([*first, starts[-1:, 1]]), wp.int32)
        m.spheres_mm = self._put(np.concatenate([c.spheres_mm for c in self._cut]), wp.float64)
        m.cells, m.ids = self._put(starts[:, 2], wp.int32), self._zeros(self.n, wp.int32)
        m.poses = self._zeros((self.n, 4, 4), wp.float64)
        shapes = (self.height, self.width), surround.shape_px
        pixels_mm = self._sensor.mm_per_px, surround.pixel_mm
        maps = self._gel_mm, self._put(surround.gel_mm, wp.float64)
        self._grids = []
        for shape, pixel_mm, gel_mm in zip(shapes, pixels_mm, maps, strict=True):
            grid = k.Grid()
            grid.gel_mm, grid.gap_mm = gel_mm, self._zeros((b, *shape), wp.float64, math.inf)
            grid.per_px, grid.every = 1.0 / pixel_mm, 1
            grid.zero_mm, grid.reach_mm = self.worlds.zero_mm, self._sensor.gel_depth_mm
            grid.lanes = CUDA_CELL if self.device.is_cuda else 1
            self._grids.append(grid)
        self._beside = self._zeros((b, surround.outside.size), wp.int32, NO_OBJECT)
        self._outside = self._put(surround.outside, wp.bool)
        return m

    def pose_meshes(self, ids: wp.array, poses: wp.array) -> None:
        """What ``indent_meshes`` then draws: the mesh of each world and where it is."""
        self._meshes = self._meshes or self._prepare_meshes()
        m, wrong = self._meshes, self.worlds.wrong
        self._launch(k.CHECK_IDS[ids.dtype], self.n, inputs=[ids, self.n_meshes, wrong, m.ids])
        tolerance = wp.float64(ROTATION_TOLERANCE)
        self._launch(k.CHECK_POSES[poses.dtype], self.n, inputs=[poses, tolerance, wrong, m.poses])

    def indent_meshes(self, start: int, *, is_depth: bool) -> None:
        """Gap maps, δ and indentation of posed meshes, with what touches beside the window."""
        window, around = self._grids
        self.worlds.zero_mm.fill_(math.inf)
        for window.every in (FIRST_ROWS, 1):
            self._rasterize(window)
            self._first_touch(window.gap_mm, 0, window.every)
        if self._surround.is_there:
            self._rasterize(around)
            per_mm = 1.0 / GAP_GRAIN_MM
            self._each(k.gather_beside, around, self._outside, per_mm, self._beside)
        self._indent(window.gap_mm, 0, self._beside, is_depth=is_depth, clears=True)

    def shear_meshes(self, gels: Any) -> None:
        """Move the objects, and the markers, with the gels that they pull; then indent anew."""
        p, lanes = self.worlds, self._lanes
        self._launch(shear_kernels.press, self._count, gels.y_mm.shape[0], lanes, inputs=[p, gels])
        inputs = p, gels, lanes
        self._launch(shear_kernels.shear, self._count, lanes, inputs=inputs, block=lanes)
        self._each(shear_kernels.carry, p, gels, self._meshes.poses)
        if p.n_markers:
            inputs = p, gels, p.sheared_mm
            self._launch(shear_kernels.carry_markers, self._count, p.n_markers, inputs=inputs)

    def _rasterize(self, grid: Any) -> None:
        dim = self._count, self._most_cells, grid.lanes
        self._launch(k.rasterize, *dim, inputs=[self._meshes, grid, self.worlds.start])

    # Imprint and picture -------------------------------------------------------------------------

    def indent_gaps(self, gap_mm: wp.array, start: int, *, is_depth: bool) -> None:
        """δ and indentation of gap maps (N, H, W)."""
        self.worlds.zero_mm.fill_(math.inf)
        self._first_touch(gap_mm, start, 1)
        self._indent(gap_mm, start, self._no_beside, is_depth=is_depth, clears=False)

    def _first_touch(self, gap_mm: wp.array, start: int, every: int) -> None:
        touch = k.FIRST_TOUCH[gap_mm.dtype]
        self._blocks(touch, gap_mm, start, every, self._block, self.worlds)

    def _indent(
        self, gap_mm: wp.array, start: int, beside: wp.array, *, is_depth: bool, clears: bool
    ) -> None:
        p = self.worlds
        self._rows(k.TO_GRAINS[gap_mm.dtype], gap_mm, start, clears, p)
        depth, weight = self._sensor.gel_depth_mm / GAP_GRAIN_MM, float(self._surround.pixels**2)
        self._blocks(k.solve, p, beside, weight, is_depth, depth, self._block)
        self._begin()
        beside_mm3 = weight * self._sensor.pixel_area_mm2 * GAP_GRAIN_MM
        self._each(k.results, p, NEGLIGIBLE_MM, beside, beside_mm3)
        self._rows(k.indent, p)

    def take_depth(self, depth_mm: wp.array, start: int) -> None:
        """An indentation (N, H, W) that is known."""
        self._begin()
        self._rows(k.take_depth, depth_mm, self.worlds)
        self._each(k.results_of_depth, self.worlds, self._sensor.gel_depth_mm, NEGLIGIBLE_MM)

    def _begin(self) -> None:
        self._rows(k.begin, self.worlds)
        self._each(k.clear, self.worlds)

    def draw(self, seed: int = 0, *, moves_markers: bool = True) -> None:
        """The pictures of what is indented; markers are else where they were put."""
        p, lights = self.worlds, self._lights
        self._deform()
        self._rows(k.shade, p, self._table)
        if lights.n:
            self._rows(k.turn, p, lights)
            dim = self._count, lights.n, self._block
            self._launch(k.sweep, *dim, inputs=[p, lights, self._block])
        if p.n_markers and moves_markers:
            inputs = p, FIELD_POINTS, DILATION_DECAY_PER_MM2, DILATION_GAIN
            self._launch(k.spread, self._count, p.n_markers, inputs=inputs)
        self._rows(k.expose, p, lights, INK_TRANSMISSION, seed)

    def _deform(self) -> None:
        p, levels = self.worlds, self._levels
        self._rows(k.place, p, self._margin)
        for number, (kernel, halvings, step, margin) in enumerate(self._stages):
            steps = [(levels[i], i, k.HALVE, levels[i + 1]) for i in range(halvings)]
            steps.append((levels[halvings], halvings, k.ALONG, self._along))
            steps.append((self._along, halvings, k.DOWN, levels[halvings]))
            back = reversed(range(halvings))
            steps += [(levels[i + 1], i, k.DOUBLE, levels[i]) for i in back]
            for source, level, how, target in steps:
                window = p.patches, margin, step, level, self.height, self.width
                inputs = source, *window, kernel, how, self._lanes, target
                rows = min(target.shape[1], levels[level].shape[1] if how == k.DOWN else 1 << 30)
                self._launch(k.resample, self._count, rows, self._lanes, inputs=inputs)
            if number + 1 < len(self._stages):
                self._rows(k.keep_contact, p, *FIRM_CONTACT)
        self._rows(k.settle, p, self._margin, NEGLIGIBLE_MM)
