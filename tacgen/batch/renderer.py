"""The memory of a batch, and the order in which its kernels run."""

import math
from typing import Any

import numpy as np
import warp as wp

from tacgen.batch import kernels as k
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
from tacgen.core.errors import ContactError, SensorError, TableError
from tacgen.core.noise import CameraNoise
from tacgen.core.records import Mesh
from tacgen.core.records import Sensor as Description
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
from tacgen.optics.render import Shader
from tacgen.optics.smooth import Gaussian
from tacgen.optics.table import LookupTable

CPU_LANES, CUDA_LANES = 1, 64  # threads on a row
CUDA_BLOCK = 256  # threads on a world, of kernels that go through all of it
CUDA_PART, CPU_PART = 256, 4  # worlds that are worked on at a time: their maps stay in the cache
FLATTEST_SLOPE = 1e-3

WRONG = (
    "the map holds NaN; use +inf where there is no object",
    "force_n is negative or not finite; give a force into the gel of 0 N or more",
    "the pose is no rotation and translation; give object to gel frame, in mm, not transposed",
    "mesh_ids has an index that add_mesh has not returned",
)
"""What each place of ``wrong`` in the kernels means."""


class BatchRenderer:
    """Draws worlds of one sensor on one device, a part of the batch at a time."""

    def __init__(
        self, sensor: Description, table: LookupTable, n: int, device: wp.Device, *, shadows: bool, noise_grey: float
    ) -> None:
        self.n, self.device, self._sensor = n, device, sensor
        self.height, self.width = sensor.shape_px
        self._lanes, self._block = (CUDA_LANES, CUDA_BLOCK) if device.is_cuda else (1, 1)
        self.part = min(n, CUDA_PART if device.is_cuda else CPU_PART)
        self._prepare_optics(table, noise_grey, shadows=shadows)
        self._prepare_pyramid(sensor.mm_per_px)
        self._allocate()
        self._surround = Surround(sensor)
        self._meshes: list[CellMesh] = []
        self._mesh_arrays: tuple[wp.array, ...] = ()

    def _put(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _zeros(self, shape: Any, dtype: Any, value: Any = 0) -> wp.array:
        return wp.full(shape, value, dtype=dtype, device=self.device)

    def _prepare_optics(self, table: LookupTable, noise_grey: float, *, shadows: bool) -> None:
        sensor, shape = self._sensor, self._sensor.shape_px
        shader = Shader(table, shadows=shadows, leds=sensor.leds)
        effects = dict(with_cast_shadows(table.effects) if shadows else table.effects)
        shadow = effects.pop(SHADOW.name, None)
        if effects:
            msg = (
                f"a batch draws no optical effect but shadows, and the table has "
                f"{', '.join(effects)}; use tacgen.Sensor, or a table without"
            )
            raise TableError(msg)
        rest_mm = np.ascontiguousarray(gel_map_mm(sensor), np.float32)
        whole = (0, shape[0], 0, shape[1])
        lit = np.empty((*shape, 3), np.float32)
        shader.light(rest_mm, whole, lit)
        image = lit.copy()
        shader.finish(rest_mm, whole, image)
        rgb = np.empty(image.shape, np.uint8)
        shade.quantize(image, whole, shade.whole_spans(whole), rgb)
        self._rest_mm = self._put(rest_mm, wp.float32)
        self._gel_mm = self._put(gel_map_mm(sensor), wp.float64)
        self._at_rest = k.AtRest()
        self._at_rest.lit = self._put(lit, wp.float32)
        self._at_rest.image = self._put(image, wp.float32)
        self._at_rest.rgb = self._put(rgb, wp.uint8)
        self._at_rest.sigma = noise_grey
        self._at_rest.quantiles = self._put(CameraNoise(1.0)._quantiles, wp.float32)
        self._table = self._table_on_device(table, shape)
        self._lights = self._lights_on_device(table, shadow)

    def _table_on_device(self, table: LookupTable, shape: tuple[int, int]) -> Any:
        model, ready = table.image_model, k.TableOnDevice()
        ready.mm_per_px = table.mm_per_px
        ready.background = self._put(table.background, wp.float32)
        contact, rest_mm = np.zeros((2, 12), np.float32), np.zeros((1, 1), np.float32)
        if isinstance(model, Quadratic):
            nodes = shade.packed_nodes(model.coefficients)
            ready.n_slope, ready.n_direction = nodes.shape[0], nodes.shape[1] - 1
            ready.interpolates = model.interpolation == "linear" and nodes.shape[0] > 1
        elif isinstance(model, Response):
            nodes = shade.packed_response(model.response)
            ready.is_response = True
            ready.node_rows, ready.node_columns = nodes.shape[:2]
            ready.n_slope, ready.n_direction = nodes.shape[2], nodes.shape[3] - 1
            rest_mm = np.full(shape, -np.inf, np.float32)  # no pixel is deeper
            contact = np.zeros((nodes.shape[0], 12 * nodes.shape[1]), np.float32)
            ready.contact_depth_mm = 1.0
            if model.contact is not None:
                contact = shade.packed_contact(model.contact.change)
                rest_mm = model.contact.rest_mm(shape, table.mm_per_px)
                ready.contact_depth_mm = model.contact.depth_mm
        else:
            msg = f"a batch cannot draw the image model {model.kind!r} yet; use tacgen.Sensor"
            raise TableError(msg)
        ready.nodes = self._put(nodes.reshape(-1), wp.float32)
        ready.per_slope = (ready.n_slope - 1) / table.max_slope_rad
        ready.per_direction = ready.n_direction / (2 * math.pi)
        ready.contact = self._put(contact, wp.float32)
        ready.contact_rest_mm = self._put(rest_mm, wp.float32)
        return ready

    def _lights_on_device(self, table: LookupTable, shadow: Any) -> Any:
        ready = k.Lights()
        if shadow is None:
            ready.share = self._zeros((1, 3), wp.float32)
            return ready
        values = SHADOW.prepare(table, self._sensor.leds, **shadow)
        strength = shadow.get("strength", DEFAULT_STRENGTH)
        leds = [(d, rgb) for d, rgb in values["leds"] if math.hypot(*d[:2]) >= 1e-6]
        total = np.maximum(np.sum([rgb for _, rgb in values["leds"]], axis=0), 1e-9)
        rows = []
        for (x, y, z), _ in leds:
            flat = math.hypot(x, y)
            x, y, rise = x / flat, y / flat, abs(z) / flat
            turned = abs(y) < abs(x)
            main, across = (x, y) if turned else (y, x)
            step_mm = table.mm_per_px / abs(main)
            rows.append((turned, main < 0, across / abs(main), rise * step_mm, rise))
        turned, down, across, rises, slopes = map(np.array, zip(*rows, strict=True))
        ready.n = len(rows)
        ready.is_turned, ready.is_downwards = self._put(turned, wp.int32), self._put(down, wp.int32)
        ready.across_px = self._put(across, wp.float32)
        ready.rise_mm = self._put(rises, wp.float32)
        shares = strength * np.array([rgb for _, rgb in leds]) / total
        ready.share = self._put(shares, wp.float32)
        ready.unlit = self._put(values["unlit"], wp.float32)
        ready.slope = max(float(slopes.min()), FLATTEST_SLOPE)
        return ready

    def _prepare_pyramid(self, mm_per_px: float) -> None:
        """The kernel, halvings, alignment and reach of every Gaussian."""
        reach, most = 1, Deformer(mm_per_px).reach_px + 1
        self._frame_margin = most
        self._stages = []
        for sigma_mm in (*PYRAMID_SIGMA_MM, FINAL_SIGMA_MM):
            blur = Gaussian(sigma_mm / mm_per_px)
            reach += blur.reach_px
            if len(blur.kernel) > 64:
                msg = f"pixels of {mm_per_px:g} mm are too small for a batch; use tacgen.Sensor"
                raise SensorError(msg)
            halvings = blur.factor.bit_length() - 1
            self._stages.append(
                (self._put(blur.kernel, wp.float32), halvings, blur.factor, min(reach, most))
            )

    def _allocate(self) -> None:
        n, b, h, w = self.n, self.part, self.height, self.width
        zeros = self._zeros
        self.rgb, self.depth_mm = zeros((n, h, w, 3), wp.uint8), zeros((n, h, w), wp.float32)
        self.contact_mask = zeros((n, h, w), wp.bool, False)
        self.indentation_mm, self.saturated = zeros(n, wp.float32), zeros(n, wp.bool, False)
        self._asked, self._wrong = zeros(n, wp.float64), zeros(len(WRONG), wp.int32, n)
        self._grains, self._no_beside = zeros((b, h, w), wp.int32), zeros((b, 0), wp.int32)
        self._zero_mm, self._delta, self._deepest = (zeros(b, wp.float64) for _ in range(3))
        self._deepest_mm, self._relief_mm = zeros(b, wp.float32), zeros(b, wp.float32)
        self._patches, self._changed = (
            wp.zeros(b, dtype=wp.vec4i, device=self.device) for _ in range(2)
        )
        self._spans = zeros((b, h, 2), wp.int32)
        self._surface, self._height_mm = zeros((b, h, w), wp.float32), zeros((b, h, w), wp.float32)
        self._height_mm.assign(np.broadcast_to(self._rest_mm.numpy(), (b, h, w)))
        half = ((h + 1) // 2 + 4, (w + 1) // 2 + 4)
        quarter = ((half[0] + 1) // 2 + 4, (half[1] + 1) // 2 + 4)
        self._levels = [self._surface, zeros((b, *half), wp.float32), zeros((b, *quarter), wp.float32)]
        self._along = zeros((b, h + 8, w + 8), wp.float32)
        self._image = zeros((b, h, w, 3), wp.float32)
        leds, one = self._lights.n, (1, 1, 1)
        self._turned = zeros((b, w, h) if leds else one, wp.float32)
        self._hidden = zeros((b, leds, h * w) if leds else one, wp.float32)
        self._met = zeros((b, leds, 2, max(h, w) + 2) if leds else (1, *one), wp.float32)

    # Launches ------------------------------------------------------------------------------------

    def _rows(self, kernel: Any, rows: int, *args: Any) -> None:
        """A kernel for rows of the part's worlds; ``args`` has where ``lanes`` goes."""
        wp.launch(kernel, dim=(self._count, rows, self._lanes), inputs=args, device=self.device)

    def _worlds(self, kernel: Any, *args: Any) -> None:
        wp.launch(kernel, dim=self._count, inputs=args, device=self.device)

    def _blocks(self, kernel: Any, *args: Any, each: int = 0) -> None:
        """A kernel of one block of threads for each world, or for ``each`` light of it."""
        dim = (self._count, each, self._block) if each else (self._count, self._block)
        wp.launch(kernel, dim=dim, inputs=args, device=self.device, block_dim=self._block)

    def parts(self) -> Any:
        """The first world of each part of the batch, which is then worked on."""
        for start in range(0, self.n, self.part):
            self._count = min(self.part, self.n - start)
            self._start = start
            yield start

    def add_mesh(self, mesh: Mesh) -> int:
        """The index of a mesh that worlds may then hold, in mm."""
        vertices, faces, _ = checked_mesh(mesh.vertices_mm, mesh.faces, np.eye(4))
        if not len(faces):
            msg = "the mesh has no faces: nothing can touch the gel"
            raise ContactError(msg)
        self._meshes.append(cut_mesh(vertices, faces))
        self._mesh_arrays = ()
        return len(self._meshes) - 1

    def _prepare_meshes(self) -> None:
        """All meshes one after the other, each cut into cells, and the memory for their gaps."""
        first, cells, n_vertices, n_faces = [0], [0], 0, 0
        vertices, faces, spheres = [], [], []
        for mesh in self._meshes:
            for cell in range(len(mesh.spheres_mm)):
                end = mesh.first[cell + 1, 1]
                faces.append(mesh.faces[mesh.first[cell, 1] : end] + n_vertices)
                first.append(n_faces + end)
            vertices.append(mesh.vertices_mm)
            spheres.append(mesh.spheres_mm)
            n_vertices, n_faces = n_vertices + len(mesh.vertices_mm), n_faces + len(mesh.faces)
            cells.append(cells[-1] + len(mesh.spheres_mm))
        self._most_cells = int(np.diff(cells).max())
        self._mesh_arrays = (
            self._put(np.concatenate(vertices), wp.float64),
            self._put(np.concatenate(faces), wp.int32),
            self._put(first, wp.int32),
            self._put(np.concatenate(spheres), wp.float64),
            self._put(cells, wp.int32),
        )
        b, surround, zeros = self.part, self._surround, self._zeros
        self._gap_mm = zeros((b, self.height, self.width), wp.float64, math.inf)
        self._gap_beside_mm = zeros((b, *surround.shape_px), wp.float64, math.inf)
        self._beside = zeros((b, surround.outside.size), wp.int32, NO_OBJECT)
        self._outside = self._put(surround.outside, wp.bool)
        self._gel_beside_mm = self._put(surround.gel_mm, wp.float64)
        self._ids, self._limits_mm = zeros(self.n, wp.int32), zeros(b, wp.float64)
        self._poses = zeros((self.n, 4, 4), wp.float64)

    def pose_meshes(self, ids: wp.array, poses: wp.array) -> None:
        """What ``indent_meshes`` then draws: the mesh of each world and where it is."""
        if not self._mesh_arrays:
            self._prepare_meshes()
        inputs = ids, len(self._meshes), self._wrong, self._ids
        wp.launch(k.check_ids, dim=self.n, inputs=inputs, device=self.device)
        inputs = poses, wp.float64(ROTATION_TOLERANCE), self._wrong, self._poses
        wp.launch(k.check_poses, dim=self.n, inputs=inputs, device=self.device)

    def indent_meshes(self, start: int, *, is_depth: bool) -> None:
        """Gap maps, δ and indentation of posed meshes, with what touches beside the window."""
        zero, reach_mm = self._zero_mm, self._sensor.gel_depth_mm
        self._limits_mm.fill_(math.inf)
        for every in (FIRST_ROWS, 1):
            self._rasterize(self._gel_mm, self._sensor.mm_per_px, every, self._gap_mm)
            zero.fill_(math.inf)
            self._blocks(k.first_touch, self._gap_mm, 0, every, zero, self._wrong, self._block)
            self._worlds(k.limit, zero, reach_mm, self._limits_mm)
        if self._surround.is_there:
            gel_mm, gap_mm = self._gel_beside_mm, self._gap_beside_mm
            self._rasterize(gel_mm, self._surround.pixel_mm, 1, gap_mm)
            per_mm = 1.0 / GAP_GRAIN_MM
            args = gap_mm, self._outside, zero, reach_mm, per_mm, self._beside
            self._worlds(k.gather_beside, *args)
        self.indent_gaps(self._gap_mm, 0, is_depth=is_depth, clears=True)

    def _rasterize(self, gel_mm: wp.array, mm_per_px: float, every: int, gap_mm: wp.array) -> None:
        lanes = 32 if self.device.is_cuda else 1
        vertices, faces, first, spheres, cells = self._mesh_arrays
        wp.launch(
            k.rasterize,
            dim=(self._count, self._most_cells, lanes),
            inputs=[vertices, faces, first, spheres, cells, self._ids, self._start]
            + [self._poses, gel_mm, 1.0 / mm_per_px, self._limits_mm, every, lanes, gap_mm],
            device=self.device,
        )

    def ask(self, force_n: wp.array, factor: float) -> None:
        """What the law asks of each gel, by its force: volume in pixels × grains, or δ in grains."""
        inputs = force_n, wp.float64(factor), self._wrong, self._asked
        wp.launch(k.check_force, dim=self.n, inputs=inputs, device=self.device)

    def problem(self) -> str:
        """What is wrong with the input of the last frames; empty if nothing is."""
        worlds = self._wrong.numpy()
        found = [f"world {w}: {text}" for w, text in zip(worlds, WRONG, strict=True) if w < self.n]
        if found:
            self._wrong.fill_(self.n)
        return found[0] if found else ""

    @property
    def n_meshes(self) -> int:
        """How many meshes there are."""
        return len(self._meshes)

    def take_depth(self, depth_mm: wp.array, start: int) -> None:
        """An indentation that is known."""
        self._begin()
        self._deepest_mm.fill_(NEGLIGIBLE_MM)
        self._rows(
            k.take_depth,
            self.height,
            *(depth_mm, start, self._lanes, self.depth_mm, self.contact_mask, self._patches),
            *(self._deepest_mm, self._wrong),
        )
        gel_depth_mm, found = self._sensor.gel_depth_mm, (self.indentation_mm, self.saturated)
        self._worlds(k.results_of_depth, self._deepest_mm, gel_depth_mm, start, *found)

    def indent_gaps(
        self, gap_mm: wp.array, start: int, *, is_depth: bool, clears: bool = False
    ) -> None:
        """δ and indentation of gap maps, of which a mesh's ``clears`` when it is read."""
        if not clears:
            self._zero_mm.fill_(math.inf)
            self._blocks(k.first_touch, gap_mm, start, 1, self._zero_mm, self._wrong, self._block)
        per_mm = wp.float64(1.0 / GAP_GRAIN_MM)
        zero = self._zero_mm
        self._rows(
            k.to_grains, self.height, gap_mm, start, zero, per_mm, clears, self._grains, self._lanes
        )
        depth = self._sensor.gel_depth_mm / GAP_GRAIN_MM
        beside = self._beside if clears else self._no_beside
        weight = float(self._surround.pixels**2)
        self._blocks(
            k.solve,
            *(self._grains, beside, weight, self._asked, is_depth, depth, self._start),
            *(self._block, self._delta, self._deepest),
        )
        self._worlds(
            k.results,
            *(self._delta, self._deepest, zero, GAP_GRAIN_MM, self._start),
            *(self.indentation_mm, self.saturated),
        )
        self._begin()
        self._rows(
            k.indent,
            self.height,
            *(self._grains, self._delta, GAP_GRAIN_MM, self._start, self._lanes),
            *(self.depth_mm, self.contact_mask, self._patches),
        )
        self._worlds(
            k.deepest_of, self._delta, GAP_GRAIN_MM, NEGLIGIBLE_MM, self._deepest_mm
        )

    def _begin(self) -> None:
        self._rows(
            k.begin,
            self.height,
            *(self._rest_mm, self._changed, self._lanes),
            *(self._height_mm, self._spans, self._patches),
        )
        self._worlds(k.clear_changed, self._changed, self._relief_mm)

    def draw(self, seed: int) -> None:
        """The pictures of what is indented."""
        self._deform()
        h, w, lanes = self.height, self.width, self._lanes
        self._rows(
            k.shade, h, self._height_mm, self._spans, self._table, lanes, self._image
        )
        mm_per_px = self._sensor.mm_per_px
        known = (self._changed, self._relief_mm)
        lights = self._lights
        if lights.n:
            self._rows(
                k.turn, h, self._height_mm, *known, lights, mm_per_px, lanes, self._turned
            )
            self._blocks(
                k.sweep,
                *(self._height_mm, self._turned, *known, lights, mm_per_px, 1 / PENUMBRA_MM),
                *(self._block, self._met, self._hidden),
                each=lights.n,
            )
        self._rows(
            k.expose,
            h,
            *(self._image, self._spans, *known, self._at_rest, lights, mm_per_px, self._hidden),
            *(seed, self._start, lanes, self.rgb),
        )

    def _deform(self) -> None:
        h, w, lanes, patches = self.height, self.width, self._lanes, self._patches
        self._rows(
            k.place, h, self.depth_mm, self._start, patches, self._frame_margin, lanes, self._surface
        )
        for number, (kernel, halvings, step, margin) in enumerate(self._stages):
            levels, window = self._levels, (patches, margin, step)
            for i in range(halvings):
                args = levels[i], *window, i, h, w, lanes, levels[i + 1]
                self._rows(k.halve, levels[i + 1].shape[1], *args)
            level = levels[halvings]
            rows, args = level.shape[1], (*window, halvings, h, w, kernel, lanes)
            self._rows(k.blur_along, rows, level, *args, self._along)
            self._rows(k.blur_down, rows, self._along, *args, level)
            for i in reversed(range(halvings)):
                args = levels[i + 1], *window, i, h, w, lanes, levels[i]
                self._rows(k.double, levels[i].shape[1], *args)
            if number + 1 < len(self._stages):
                self._rows(
                    k.keep_contact,
                    h,
                    *(self.depth_mm, self._start, patches, self._deepest_mm, *FIRM_CONTACT),
                    *(lanes, self._surface),
                )
        self._rows(
            k.settle,
            h,
            *(self._surface, patches, self._frame_margin, self._rest_mm, NEGLIGIBLE_MM, lanes),
            *(self._height_mm, self._changed, self._spans, self._relief_mm),
        )
