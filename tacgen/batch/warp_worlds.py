"""A batch on a GPU: its memory in Warp, and the order in which the kernels run."""

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from tacgen.batch import warp_kernels as k
from tacgen.batch.arrays import as_numpy, check, check_memory, free_bytes
from tacgen.batch.gels import Loads
from tacgen.batch.threads import WRONG_MAP
from tacgen.contact.gap import GAP_GRAIN_MM, NO_OBJECT, Surround, checked_mesh
from tacgen.contact.gel import gel_map_mm
from tacgen.contact.gel_shear import GelShear
from tacgen.contact.indenter import FIELD_POINTS
from tacgen.contact.shear import DILATION_DECAY_PER_MM2, DILATION_GAIN, marker_grid_mm
from tacgen.contact.shear_field import ShearState
from tacgen.core.errors import ContactError, SensorError, TableError
from tacgen.core.processes import available_cores
from tacgen.core.records import Markers, Mesh
from tacgen.core.records import Sensor as Description
from tacgen.optics import shade
from tacgen.optics.deform import FINAL_SIGMA_MM, FIRM_CONTACT, NEGLIGIBLE_MM, PYRAMID_SIGMA_MM
from tacgen.optics.effects import with_cast_shadows
from tacgen.optics.effects.shadow import PENUMBRA_MM, SHADOW
from tacgen.optics.effects.skirt import SKIRT, skirt_width
from tacgen.optics.image_models import Quadratic, Response
from tacgen.optics.markers import INK_TRANSMISSION
from tacgen.optics.noise import CameraNoise
from tacgen.optics.render import Shader
from tacgen.optics.smooth import BEYOND, HALVED_FROM_PX, Gaussian
from tacgen.optics.table import LookupTable

PART = 1024
"""Worlds that are worked on at a time: more threads than a GPU has, for the solves of a thread a
world too."""
BYTES_PER_PX, BYTES_PER_PX_WITH_SHADOWS = 60, 80  # of a world at work
LOOK_EVERY = 8  # steps of the solve, from look to look at whether it is done
_PER_MM = wp.float64(1.0 / GAP_GRAIN_MM)
TEST_DEVICE = "warp:cpu"
"""Warp's own CPU, on which tests run the kernels."""


def find_device(device: Any) -> wp.Device:
    """The device of that name, or of torch; a ``SensorError`` if Warp does not have it."""
    name = str(device)
    try:
        if name == TEST_DEVICE:
            return wp.get_device("cpu")
        if name.startswith("cuda") and not wp.is_cuda_available():
            msg = f"device = {name!r} is not here: Warp finds no CUDA GPU; give device='cpu'"
            raise SensorError(msg)
        return wp.get_device(name)
    except OSError as error:
        msg = f"Warp cannot keep what it compiles ({error}); set WARP_CACHE_PATH to another folder"
        raise SensorError(msg) from None
    except (ValueError, RuntimeError):
        known = ", ".join(str(one) for one in wp.get_devices())
        msg = f"device = {name!r} is not here (Warp sees {known}); give one of these, such as 'cpu'"
        raise SensorError(msg) from None


def undrawable(table: LookupTable) -> str:
    """Why pictures of a sensor cannot be drawn in Warp; empty if they can."""
    drawn, model = (SHADOW.name, SKIRT.name), table.image_model
    others = [name for name in table.effects if name not in drawn]
    if others:
        named = ", ".join(others)
        return f"a GPU draws no optical effect but shadows and skirts; the table has {named}"
    if table.effects.get(SHADOW.name, {}).get("lamp_distance_mm"):
        return "a GPU draws shadows of lamps far away alone; the table has near ones"
    if not isinstance(model, Quadratic | Response):
        return f"a GPU cannot draw the image model {model.kind!r} yet"
    return ""


class WarpWorlds:
    """N worlds of one sensor on one device, drawn a part of the batch at a time.

    With ``keeps_grey`` the pictures are grey levels before they are rounded. Raises ``TableError``
    if the table cannot be drawn so, ``SensorError`` if the memory does not suffice.
    """

    def __init__(
        self,
        sensor: Description,
        table: LookupTable,
        n: int,
        device: wp.Device,
        *,
        shadows: bool,
        markers: bool,
        seed: int | None = None,
        keeps_grey: bool = False,
    ) -> None:
        if problem := undrawable(table):
            msg = f"{problem}; use device='cpu'"
            raise TableError(msg)
        self.n, self.device, self._sensor, self._seed = n, device, sensor, seed
        self.height, self.width = sensor.shape_px
        self._surround = Surround(sensor)
        self._cut = list[Mesh]()
        self._meshes: Any = None
        self._gel_shear, self._pool = GelShear(sensor), ThreadPoolExecutor(available_cores())
        self._before: list[ShearState | None] = [None] * n
        self._part = self._fitting_part(shadows=shadows)
        self.worlds = self._allocate()
        if keeps_grey:
            self.worlds.grey = self._zeros((n, self.height, self.width, 3), wp.float32)
        self._prepare_optics(table, table.noise_grey if seed is not None else 0.0, shadows=shadows)
        self._prepare_solve()
        self._prepare_pyramid(skirt_width(table.effects))
        if markers and sensor.markers is not None:
            self._prepare_markers(sensor.markers)

    def _put(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=self.device)

    def _zeros(self, shape: Any, dtype: Any) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)

    def _fitting_part(self, *, shadows: bool) -> int:
        """How many worlds to work on at a time."""
        per_px = BYTES_PER_PX_WITH_SHADOWS if shadows else BYTES_PER_PX
        at_work, device = per_px * self.height * self.width, self.device
        free = int(device.free_memory) if device.is_cuda else free_bytes()
        left = check_memory(self.n, self._sensor.shape_px, str(device), free, at_work)
        return int(max(1, min(self.n, PART, left // at_work)))

    def _allocate(self) -> Any:
        n, b, h, w, zeros = self.n, self._part, self.height, self.width, self._zeros
        p = k.Worlds()
        p.mm_per_px, p.grain_mm = self._sensor.mm_per_px, GAP_GRAIN_MM
        p.wrong, p.asked = self._put([n], wp.int32), zeros(n, wp.float64)
        p.rgb, p.depth_mm = zeros((n, h, w, 3), wp.uint8), zeros((n, h, w), wp.float32)
        p.contact_mask, p.saturated = zeros((n, h, w), wp.bool), zeros(n, wp.bool)
        p.beside_mm3, p.indentation_mm = zeros(n, wp.float64), zeros(n, wp.float32)
        p.zero_mm, p.delta, p.deepest = (zeros(b, wp.float64) for _ in range(3))
        p.gap_mm, p.grains = zeros((b, h, w), wp.float64), zeros((b, h, w), wp.int32)
        p.patches, p.deepest_mm = zeros(b, wp.vec4i), zeros(b, wp.float32)
        p.image = zeros((b, h, w, 3), wp.float32)
        p.rest_mm = self._put(gel_map_mm(self._sensor), wp.float32)
        return p

    def _prepare_optics(self, table: LookupTable, noise_grey: float, *, shadows: bool) -> None:
        sensor, shape, p = self._sensor, self._sensor.shape_px, self.worlds
        effects = dict(with_cast_shadows(table.effects) if shadows else table.effects)
        lit = np.empty((*shape, 3), np.float32)
        rest_mm = np.ascontiguousarray(gel_map_mm(sensor), np.float32)
        shader = Shader(table, shadows=shadows, leds=sensor.leds)
        shader.light(rest_mm, (0, shape[0], 0, shape[1]), lit)
        p.lit_at_rest, p.noise_grey = self._put(lit, wp.float32), noise_grey
        p.quantiles = self._put(CameraNoise(noise_grey).quantiles, wp.float32)
        self._table = self._table_on_device(table, shape)
        self._lights = self._lights_on_device(table, effects.get(SHADOW.name))

    def _table_on_device(self, table: LookupTable, shape: tuple[int, int]) -> Any:
        model, ready = table.image_model, k.Table()
        quadratic: NDArray[np.floating]
        response: NDArray[np.floating]
        contact: NDArray[np.floating]
        quadratic, response = np.zeros((1, 1, 6, 4)), np.zeros((1, 1, 1, 4))
        contact, rest_mm = np.zeros((2, 2, 3, 4)), np.full(shape, -np.inf)  # no pixel is deeper
        ready.node_rows = ready.node_columns = 2
        if isinstance(model, Quadratic):
            nodes = shade.packed_nodes(model.coefficients)
            quadratic = nodes.reshape(*nodes.shape[:2], 6, 4)
            ready.next = int(model.interpolation == "linear" and len(nodes) > 1)
        elif isinstance(model, Response):  # else it is refused
            nodes = shade.packed_response(model.response)
            ready.node_rows, ready.node_columns = nodes.shape[:2]
            response = nodes.reshape(-1, *nodes.shape[2:])
            nodes = response[0]
            ready.is_response, ready.next = True, 1
            if model.contact is not None:
                packed = shade.packed_contact(model.contact.change)
                contact = packed.reshape(len(packed), -1, 3, 4)
                rest_mm = model.contact.rest_mm(shape, table.mm_per_px)
                ready.contact_depth_mm = model.contact.depth_mm
        ready.n_slope, ready.n_direction = nodes.shape[0], nodes.shape[1] - 1
        ready.per_slope = (ready.n_slope - 1) / table.max_slope_rad
        ready.per_direction = ready.n_direction / (2 * math.pi)
        ready.quadratic = self._put(quadratic, wp.float32)
        ready.response = self._put(response, wp.float32)
        ready.contact = self._put(contact, wp.float32)
        ready.contact_rest_mm = self._put(rest_mm, wp.float32)
        ready.background = self._put(table.background, wp.float32)
        return ready

    def _lights_on_device(self, table: LookupTable, shadow: Any) -> Any:
        """The lights as ``optics.effects.shadow.cast_shadow`` takes them."""
        ready, b, h, w = k.Lights(), self._part, self.height, self.width
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
            rise_mm = abs(z) / flat * table.mm_per_px * flat / abs(main)
            rows.append((is_turned, main < 0, across / abs(main), rise_mm))
            shares.append(values["strengths"] * np.asarray(rgb))
        turned, down, across_px, rises_mm = zip(*rows, strict=True)
        total = np.maximum(np.sum([rgb for _, rgb in values["leds"]], axis=0), 1e-9)
        ready.n, ready.per_mm = len(rows), 1.0 / PENUMBRA_MM
        ready.is_turned, ready.is_downwards = self._put(turned, wp.int32), self._put(down, wp.int32)
        ready.across_px = self._put(across_px, wp.float32)
        ready.rise_mm = self._put(rises_mm, wp.float32)
        ready.share = self._put(np.array(shares) / total, wp.float32)
        ready.unlit = self._put(values["unlit"], wp.float32)
        ready.met = self._zeros((b, ready.n, 2, max(h, w)), wp.float32)
        ready.hidden = self._zeros((b, ready.n, h, w), wp.float32)
        return ready

    def _prepare_solve(self) -> None:
        b, around = self._part, self._surround
        self._gel_mm = self._put(gel_map_mm(self._sensor), wp.float64)
        self._whole = self._put(np.ones((self.height, self.width), bool), wp.bool)
        shape = around.shape_px if around.is_there else (1, 1)
        self._around_gel_mm = self._put(around.gel_mm, wp.float64)
        self._outside = self._put(around.outside, wp.bool)
        self._around_gap_mm = self._zeros((b, *shape), wp.float64)
        self._beside = wp.full((b, *shape), NO_OBJECT, dtype=wp.int32, device=self.device)
        self._first_beside = self._zeros(b, wp.float64)
        self._sums = self._zeros((b, 2), wp.int64), self._zeros((b, 2), wp.int64)
        self._n_open = self._zeros(1, wp.int32)
        self._cells = self._zeros((b, *self._gel_shear.shape), wp.float64)

    def _prepare_markers(self, markers: Markers) -> None:
        p, places_mm = self.worlds, marker_grid_mm(self._sensor)
        p.n_markers, p.marker_radius_px = len(places_mm), markers.radius_mm / self._sensor.mm_per_px
        p.markers_at_rest_mm = self._put(places_mm, wp.float32)
        p.markers_mm = self._zeros((self.n, len(places_mm), 2), wp.float32)
        p.sheared_mm = self._zeros((self.n, len(places_mm), 2), wp.float32)

    def _prepare_pyramid(self, width: float) -> None:
        """The kernel and halvings of every Gaussian, and memory for the levels, two maps each."""
        self._stages = []
        for sigma_mm in (*(width * sigma for sigma in PYRAMID_SIGMA_MM), FINAL_SIGMA_MM):
            blur = Gaussian(sigma_mm / self._sensor.mm_per_px)
            self._stages.append((self._put(blur.kernel, wp.float32), blur.factor.bit_length() - 1))
        shape, self._levels = self._sensor.shape_px, list[tuple[wp.array, wp.array]]()
        for _ in range(1 + len(HALVED_FROM_PX)):
            first, other = (self._zeros((self._part, *shape), wp.float32) for _ in range(2))
            self._levels.append((first, other))
            shape = (shape[0] + 1) // 2 + 2 * BEYOND, (shape[1] + 1) // 2 + 2 * BEYOND
        self.worlds.surface = self._levels[0][0]

    # What a BatchSensor asks for -----------------------------------------------------------------

    def read(
        self, array: Any, name: str, shape: tuple[int, ...], dtypes: tuple[str, ...]
    ) -> wp.array:
        """A Warp array that shares the memory of an array of any library."""
        if isinstance(array, wp.array):
            found = array
        elif isinstance(array, np.ndarray) or not hasattr(array, "__dlpack__"):
            values = as_numpy(array, name, shape, dtypes)
            found = wp.array(values, device="cpu", copy=False)
            if not isinstance(array, np.ndarray):
                found = found.to(self.device)
        else:
            try:
                found = wp.from_dlpack(array.detach() if hasattr(array, "detach") else array)
            except (TypeError, ValueError, RuntimeError, BufferError) as error:
                msg = f"{name} cannot be read on {self.device} ({error}); move or convert it"
                raise SensorError(msg) from None
        if found.device != self.device:
            msg = f"{name} is on {found.device}, the sensor on {self.device}: move it there"
            raise SensorError(msg)
        check(name, tuple(found.shape), found.dtype.__name__, shape, dtypes)
        return found if found.is_contiguous else found.contiguous()

    def small(
        self, array: Any, name: str, shape: tuple[int, ...], dtypes: tuple[str, ...]
    ) -> NDArray[Any]:
        """The same on the host: a few numbers a world."""
        return np.asarray(self.read(array, name, shape, dtypes).numpy())

    def out(self, array: NDArray[Any], kind: str) -> Any:
        """An array of the host as one of that library, on the device."""
        return self._as_kind(wp.array(array, device=self.device), kind)

    def _as_kind(self, array: wp.array, kind: str) -> Any:
        if kind == "torch":
            return wp.to_torch(array, requires_grad=False)
        if kind == "jax":
            return wp.to_jax(array)
        return array.numpy() if kind == "numpy" and array.device.is_cpu else array

    def frames(self, kind: str) -> dict[str, Any]:
        """The worlds' last frames, as arrays of that library."""
        names = ["rgb", "depth_mm", "contact_mask", "indentation_mm", "saturated"]
        names += ["markers_mm"] if self.worlds.n_markers else []
        return {name: self._as_kind(getattr(self.worlds, name), kind) for name in names}

    def shares(self) -> NDArray[np.float64]:
        """The part of each world's pressure that acts in the window, (N,); NaN without contact."""
        beside_mm3, area_mm2 = self.worlds.beside_mm3.numpy(), self._sensor.pixel_area_mm2
        shares = np.where(self.worlds.indentation_mm.numpy() > 0.0, 1.0, np.nan)
        for world in np.flatnonzero(beside_mm3):  # the maps of the others stay on the device
            depth_mm = self.worlds.depth_mm[int(world)].numpy()
            shown_mm3 = float(depth_mm.sum(dtype=np.float64)) * area_mm2
            shares[world] = shown_mm3 / (shown_mm3 + beside_mm3[world])
        return shares

    @property
    def n_meshes(self) -> int:
        """How many meshes there are."""
        return len(self._cut)

    def add_mesh(self, mesh: Mesh) -> int:
        """The index of a mesh that worlds may then hold, in mm."""
        vertices, faces, _ = checked_mesh(mesh.vertices_mm, mesh.faces, np.eye(4))
        self._cut.append(Mesh.fixed(vertices, faces))
        self._meshes = None
        return len(self._cut) - 1

    def draw_gaps(self, gap_mm: wp.array, loads: Loads, call: int) -> None:
        """The frames of gap maps (N, H, W)."""
        self._ask(loads)
        for _ in self._parts():
            self._pixels(k.take_gaps, gap_mm, self.worlds)
            self._first_touch()
            self._beside.fill_(NO_OBJECT)
            self._indent()
            self._draw(call)
        self._refuse()

    def draw_depths(self, depth_mm: wp.array, call: int) -> None:
        """The frames of indentations (N, H, W)."""
        self._release_markers()
        for _ in self._parts():
            self._take_depth(depth_mm)
            self._draw(call)
        self._refuse()

    def draw_meshes(
        self, ids: NDArray[np.int64], poses: NDArray[np.float64], loads: Loads, call: int
    ) -> None:
        """The frames of meshes at poses (N, 4, 4), pulled where the loads do."""
        self._meshes = self._meshes or self._prepare_meshes()
        self._meshes.ids.assign(ids.astype(np.int32))
        self._meshes.poses.assign(poses)
        self._ask(loads)
        for world in np.flatnonzero(loads.is_new):
            self._before[world] = None
        for _ in self._parts():
            self._meet()
            self._indent()
            if loads.is_sheared:
                self._shear(poses, loads)
                self._meet()
                self._indent()
            self._draw(call)
        if not loads.keeps:
            self._before = [None] * self.n

    def draw_imprints(self, depth_mm: wp.array, n: int, markers_mm: Any) -> NDArray[np.float32]:
        """Grey levels of the first ``n`` indentations, with markers at ``markers_mm``."""
        if self.worlds.n_markers:
            self.worlds.markers_mm[:n].assign(np.asarray(markers_mm, np.float32))
        for _ in self._parts(n):
            self._take_depth(depth_mm)
            self._draw(0, moves_markers=False)
        return np.asarray(self.worlds.grey.numpy())

    # Launches ------------------------------------------------------------------------------------

    def _launch(self, kernel: Any, dim: Any, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=list(inputs), device=self.device)

    def _pixels(self, kernel: Any, *inputs: Any) -> None:
        """A kernel for every pixel of the worlds at work."""
        self._launch(kernel, (self._count, self.height, self.width), *inputs)

    def _parts(self, n: int | None = None) -> Iterator[int]:
        """The first world of each part of the batch, which is then at work; of the first ``n``."""
        n = self.n if n is None else n
        for start in range(0, n, self._part):
            self._count, self.worlds.start = min(self._part, n - start), start
            yield start

    def _refuse(self) -> None:
        """Raise ``ContactError`` if a map that was given is wrong, once."""
        world = int(self.worlds.wrong.numpy()[0])
        if world < self.n:
            self.worlds.wrong.fill_(self.n)
            msg = f"world {world}: {WRONG_MAP}"
            raise ContactError(msg)

    def _release_markers(self) -> None:
        if self.worlds.n_markers:
            self.worlds.sheared_mm.zero_()

    def _ask(self, loads: Loads) -> None:
        """Put what the law asks of each gel on the device."""
        self._is_depth = loads.law.law == "linear_depth"
        per_unit = GAP_GRAIN_MM * (1.0 if self._is_depth else self._sensor.pixel_area_mm2)
        self.worlds.asked.assign(loads.normal / per_unit)
        self._release_markers()

    # Meshes --------------------------------------------------------------------------------------

    def _prepare_meshes(self) -> Any:
        """All meshes, each about the middle of its vertices, for rays and for their triangles."""
        m = k.Meshes()
        vertices = [np.asarray(one.vertices_mm) for one in self._cut]
        middles = [(one.min(axis=0) + one.max(axis=0)) / 2 for one in vertices]
        about = [one - middle for one, middle in zip(vertices, middles, strict=True)]
        starts = np.cumsum([0, *map(len, vertices)])
        faces = [np.asarray(one.faces, np.int32) for one in self._cut]
        self._handles = [
            wp.Mesh(self._put(one, wp.vec3f), self._put(corners.reshape(-1), wp.int32))
            for one, corners in zip(about, faces, strict=True)
        ]
        m.handles = self._put(np.array([one.id for one in self._handles], np.uint64), wp.uint64)
        m.middle_mm = self._put(middles, wp.vec3d)
        radii_mm = [np.linalg.norm(one, axis=1).max() for one in about]
        m.radius_mm = self._put(radii_mm, wp.float64)
        m.vertices_mm = self._put(np.concatenate(about), wp.vec3d)
        numbered = [one + start for one, start in zip(faces, starts, strict=False)]
        m.faces = self._put(np.concatenate(numbered), wp.int32)
        m.first_face = self._put(np.cumsum([0, *map(len, faces)]), wp.int32)
        m.ids, m.poses = self._zeros(self.n, wp.int32), self._zeros(self.n, wp.mat44d)
        return m

    def _meet(self) -> None:
        """Gaps of posed meshes over the window, and around it in grains."""
        p, m, around = self.worlds, self._meshes, self._surround
        pixel_mm = wp.float64(self._sensor.mm_per_px)
        self._pixels(k.cast_rays, m, p.start, pixel_mm, self._gel_mm, p.gap_mm)
        self._first_touch()
        if around.is_there:
            dim, pixel_mm = (self._count, *around.shape_px), wp.float64(around.pixel_mm)
            gap_mm, zero_mm = self._around_gap_mm, wp.clone(p.zero_mm)
            self._launch(k.cast_rays, dim, m, p.start, pixel_mm, self._around_gel_mm, gap_mm)
            self._launch(k.first_touch_beside, dim, gap_mm, self._outside, p, zero_mm)
            self._launch(k.to_grains, dim, gap_mm, self._outside, zero_mm, _PER_MM, self._beside)

    def _first_touch(self) -> None:
        self.worlds.zero_mm.fill_(math.inf)
        self._pixels(k.first_touch, self.worlds.gap_mm, self.worlds.zero_mm)

    def _indent(self) -> None:
        """δ and indentation of the gaps."""
        p, beside = self.worlds, self._beside
        self._pixels(k.to_grains, p.gap_mm, self._whole, p.zero_mm, _PER_MM, p.grains)
        self._solve()
        weight = float(self._surround.pixels**2)
        each_mm3 = wp.float64(weight * self._sensor.pixel_area_mm2 * GAP_GRAIN_MM)
        self._launch(k.results, self._count, p, NEGLIGIBLE_MM, beside, each_mm3)
        self._begin()
        self._pixels(k.indent, p)

    def _solve(self) -> None:
        p, beside = self.worlds, self._beside
        gel_depth = wp.float64(self._sensor.gel_depth_mm / GAP_GRAIN_MM)
        weight = wp.float64(self._surround.pixels**2)
        self._first_beside.zero_()
        self._launch(k.least_grains, (self._count, beside.shape[1]), beside, self._first_beside)
        self._launch(k.begin_solve, self._count, p, self._is_depth, gel_depth, self._first_beside)
        while not self._is_depth:
            for _ in range(LOOK_EVERY):
                self._n_open.zero_()
                for grains, sums in zip((p.grains, beside), self._sums, strict=True):
                    self._launch(k.sum_below, (self._count, grains.shape[1]), p, grains, sums)
                inputs = p, *self._sums, weight, self._n_open
                self._launch(k.newton_step, self._count, *inputs)
            if not self._n_open.numpy()[0]:
                return

    def _shear(self, poses: NDArray[np.float64], loads: Loads) -> None:
        """Move the objects, and the markers, with the gels that they pull.

        The few hundred points of a lattice are solved on the host, as for a single sensor.
        """
        p, shear, points_mm = self.worlds, self._gel_shear, marker_grid_mm(self._sensor)
        inputs = p, shear.pixels, *shear.before_px, self._cells
        self._launch(k.press, (self._count, *self._cells.shape[1:]), *inputs)
        sums, beside_mm3 = self._cells.numpy(), p.beside_mm3.numpy()
        moved_mm = np.zeros((self._count, len(points_mm), 2), np.float32)

        def follow(w: int) -> None:
            world, total = p.start + w, float(sums[w].sum())
            before, self._before[world] = self._before[world], None
            if total <= 0.0:
                return
            shown_mm3, load = total * self._sensor.pixel_area_mm2, loads.of(world)
            share = shown_mm3 / (shown_mm3 + float(beside_mm3[world]))
            weight = sums[w] / total
            state = shear.step(lambda: weight, load, share, before)
            if state is not None:
                poses[world] = shear.object_motion(state, load).moved(poses[world])
                moved_mm[w] = shear.motion_mm(state, points_mm, load)
                self._before[world] = state

        list(self._pool.map(follow, range(self._count)))
        self._meshes.poses.assign(poses)
        if p.n_markers:
            p.sheared_mm[p.start : p.start + self._count].assign(moved_mm)

    # The picture ---------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Nothing is indented yet."""
        self.worlds.patches.fill_(wp.vec4i(1 << 30, 1 << 30, 0, 0))

    def _take_depth(self, depth_mm: wp.array) -> None:
        p = self.worlds
        self._begin()
        p.deepest_mm.zero_()
        self._pixels(k.take_depth, depth_mm, p)
        inputs = p, self._sensor.gel_depth_mm, NEGLIGIBLE_MM
        self._launch(k.results_of_depth, self._count, *inputs)

    def _draw(self, call: int, *, moves_markers: bool = True) -> None:
        """The pictures of what is indented; markers are else where they were put."""
        p, lights = self.worlds, self._lights
        for number, (kernel, halvings) in enumerate(self._stages):
            self._blur(kernel, halvings)
            if number + 1 < len(self._stages):
                self._pixels(k.keep_contact, p, *FIRM_CONTACT)
        self._pixels(k.shade, p, self._table, NEGLIGIBLE_MM)
        longest = max(self.height, self.width)
        for i in range(longest if lights.n else 0):
            self._launch(k.sweep, (self._count, lights.n, longest), p, lights, NEGLIGIBLE_MM, i)
        if p.n_markers and moves_markers:
            inputs = p, FIELD_POINTS, wp.float64(DILATION_DECAY_PER_MM2), wp.float64(DILATION_GAIN)
            self._launch(k.spread, (self._count, p.n_markers), *inputs)
        seed = ((self._seed or 0) * 0x9E3779B1 + call * 0x85EBCA77) % (1 << 32)
        self._pixels(k.expose, p, lights, INK_TRANSMISSION, wp.uint32(seed))

    def _blur(self, kernel: wp.array, halvings: int) -> None:
        """One Gaussian of the surface, on means of blocks that were halved so often."""
        levels = self._levels
        for level in range(halvings):
            source, target = levels[level][0], levels[level + 1][0]
            self._launch(k.halve, (self._count, *target.shape[1:]), source, target)
        surface, other = levels[halvings]
        dim = self._count, *surface.shape[1:]
        self._launch(k.blur, dim, surface, kernel, 0, other)
        self._launch(k.blur, dim, other, kernel, 1, surface)
        for level in reversed(range(halvings)):
            source, target = levels[level + 1][0], levels[level][0]
            self._launch(k.double, (self._count, *target.shape[1:]), source, target)
