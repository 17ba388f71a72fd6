"""A tactile pad: from a posed mesh and the load on the gel to the imprint and the image."""

from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel import gel_map_mm
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.gel_shear import GelShear
from tacgen.contact.indenter import Imprint, Indenter
from tacgen.contact.shear import dilation_mm, marker_grid_mm
from tacgen.contact.shear_field import weighted
from tacgen.core.errors import SensorError, TableError
from tacgen.core.records import Mesh, Sensor
from tacgen.core.sensors import no_markers
from tacgen.core.types import FloatArray, Window
from tacgen.optics.deform import Deformer
from tacgen.optics.effects.skirt import skirt_width
from tacgen.optics.render import Renderer
from tacgen.optics.table import LookupTable, load_table
from tacgen.optics.visible import VISIBLE, visible_share

SAME_SCALE = 0.01  # relative difference of mm/px between a table and its sensor: 2 % of an area


SAME_SLOPE = 0.02
"""Difference in slope at the window's edge between the gel of a table and its sensor's: by it a
picture changes as by its own noise."""


def _curvature(dome_radius_mm: float) -> float:
    return 1.0 / dome_radius_mm if dome_radius_mm else 0.0


class TactilePad:
    """One tactile pad, made ready for frame after frame.

    ``table`` is the sensor's own if not given; ``camera`` ("raster" or "pyrender") takes the gap
    map.

    Raises ``ContactError`` if the camera cannot be used, ``TableError`` if the table cannot be read
    or does not fit, ``SensorError`` if there are no markers to draw.
    """

    def __init__(
        self,
        sensor: Sensor,
        table: LookupTable | None = None,
        *,
        camera: str = "raster",
        shadows: bool = False,
        markers: bool = False,
    ) -> None:
        table = load_table(sensor.table) if table is None else table
        if table.shape_px != sensor.shape_px:
            (rows, columns), (height, width) = table.shape_px, sensor.shape_px
            msg = (
                f"{sensor.table}: the table is of {columns}×{rows} pixels, the sensor "
                f"{sensor.name!r} of {width}×{height}; give the table that was calibrated on it"
            )
            raise TableError(msg)
        if abs(table.mm_per_px / sensor.mm_per_px - 1.0) > SAME_SCALE:
            msg = (
                f"the table is of {table.mm_per_px:g} mm/px, the sensor {sensor.name} of "
                f"{sensor.mm_per_px:g}: its pictures would be of another size on the gel; write "
                f"`mm_per_px: {table.mm_per_px:g}` beside the table"
            )
            raise TableError(msg)
        dome_mm = table.geometry.get("dome_radius_mm", sensor.dome_radius_mm)
        edge_mm = sensor.mm_per_px * max(sensor.shape_px) / 2
        off = abs(_curvature(dome_mm) - _curvature(sensor.dome_radius_mm)) * edge_mm
        if off > SAME_SLOPE:
            msg = (
                f"the table is of a gel with a dome of {dome_mm:g} mm (0: flat), the sensor "
                f"{sensor.name} of {sensor.dome_radius_mm:g}: at rest its picture would be "
                f"another; write `dome_radius_mm: {dome_mm:g}` beside the table"
            )
            raise TableError(msg)
        if markers and sensor.markers is None:
            raise SensorError(no_markers(sensor.name))
        self.sensor = sensor
        self.table = table
        self.indenter = Indenter(sensor, camera)
        self._deformer = Deformer(sensor.mm_per_px, skirt_width(table.effects))
        self._renderer = Renderer(
            table,
            gel_map_mm(sensor),
            shadows=shadows,
            leds=sensor.leds,
            marker_radius_mm=sensor.markers.radius_mm if markers and sensor.markers else 0.0,
        )
        self._points_mm, self._shear = marker_grid_mm(sensor), GelShear(sensor)
        self.casts_shadows, self.draws_markers = shadows, markers
        self._drawn: Imprint | None = None

    def press(
        self,
        mesh: Mesh,
        pose_gel_object: FloatArray,
        load: GelLoad,
        before: Imprint | None = None,
    ) -> Imprint:
        """The imprint of an object at a pose (4, 4), object to gel frame in mm.

        Where along z the object stands does not matter: it is taken to first touch, and from
        there pressed in until the gel has lost the load's volume, or to the load's depth.
        ``before`` is the imprint of the frame before, whose shear the gel remembers; None: at rest.
        """
        imprint = self.advance(mesh, pose_gel_object, load, before)
        if imprint.shear is None:
            return imprint
        motion = self._shear.object_motion(imprint.shear, load)
        pose = motion.moved(np.asarray(pose_gel_object, dtype=np.float64))
        moved = self.indenter.indent(mesh, pose, load)
        return replace(moved, motion=motion, shear=imprint.shear, load=load)

    def advance(
        self, mesh: Mesh, pose_gel_object: FloatArray, load: GelLoad, before: Imprint | None
    ) -> Imprint:
        """``press`` for the shear alone: the imprint of the object where it is not moved by it."""
        imprint = self.indenter.indent(mesh, pose_gel_object, load)
        if imprint.indentation_mm <= 0 or not imprint.depth_mm.size:
            return imprint
        last = None if before is None else before.shear
        weigh = partial(self._shear.pressure_share, imprint.depth_mm, imprint.window)
        shear = self._shear.step(weigh, load, imprint.share, last)
        return replace(imprint, shear=shear, load=load)

    def image(
        self,
        imprint: Imprint,
        *,
        rng: np.random.Generator | None = None,
        rgb: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """The sensor's image (H, W, 3) of an imprint; ``rng`` draws the camera's noise.

        It is written into ``rgb``, if given. A second image of the same object differs by its noise
        alone, and is not drawn again.
        """
        if imprint is not self._drawn:
            deformation, window = self.deformation(imprint)
            self._renderer.draw(deformation, window, markers_mm=self.markers_mm(imprint))
            self._drawn = imprint
        return self._renderer.expose(rng, rgb)

    def markers_mm(self, imprint: Imprint) -> NDArray[np.float64] | None:
        """Places (n, 2) of the marker dots, gel frame, mm; None where none are drawn."""
        if not self.draws_markers:
            return None
        return self._points_mm + self.marker_motion_mm(imprint)

    @property
    def marker_rest_mm(self) -> NDArray[np.float64]:
        """Places (M, 2) of the markers at rest, gel frame; a plain grid where the gel has none."""
        return self._points_mm

    def marker_motion_mm(self, imprint: Imprint) -> NDArray[np.float64]:
        """How far each marker (M, 2) is from where it is at rest, x and y of the gel, mm."""
        if not imprint.depth_mm.size:
            return np.zeros_like(self._points_mm)
        moved = dilation_mm(self._points_mm, *self.indenter.sampled(imprint))
        if imprint.shear is None:
            return moved
        return moved + self._shear.motion_mm(imprint.shear, self._points_mm, imprint.load)

    def force_field_n(
        self, imprint: Imprint, force_n: FloatArray, shape: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Force on each cell of a grid over the window, (rows, columns, 3): shear x, y, normal.

        It sums to ``force_n`` (3,), the part of the frame's force that acts in the window.
        """
        force = np.asarray(force_n, np.float64)
        if not imprint.depth_mm.size:
            return np.zeros((*shape, 3))
        share = self._shear.pressure_share(imprint.depth_mm, imprint.window)[..., None]
        lattice_n = share * force
        if imprint.shear is not None:
            ones = np.ones(imprint.shear.pressure.shape)
            total = weighted(ones, imprint.shear.pressure[..., None])
            share = imprint.shear.pressure[..., None] / total
            pulls_n = imprint.shear.traction * self._shear.cell_mm2
            missing_n = force[:2] - weighted(ones, pulls_n)
            lattice_n = np.concatenate([pulls_n + share * missing_n, share * force[2]], axis=-1)
        return self._shear.cells(lattice_n, shape)

    def render(
        self,
        mesh: Mesh,
        pose_gel_object: FloatArray,
        load: GelLoad,
        *,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.uint8]:
        """``press`` and ``image`` in one."""
        return self.image(self.press(mesh, pose_gel_object, load), rng=rng)

    @cached_property
    def at_rest_rgb(self) -> NDArray[np.uint8]:
        """The image (H, W, 3) of the gel with nothing on it, without noise; read-only."""
        rgb = self.image(Imprint())
        rgb.setflags(write=False)
        return rgb

    def visible_share(self, rgb: NDArray[np.uint8]) -> float:
        """The share of an image's pixels that differ visibly from the gel at rest."""
        return visible_share(rgb, self.at_rest_rgb, self.table.noise_grey)

    def shows_contact(self, rgb: NDArray[np.uint8]) -> bool:
        """Whether a person sees in an image that something touches the gel."""
        return self.visible_share(rgb) >= VISIBLE.contact_share

    def deformation(self, imprint: Imprint) -> tuple[NDArray[np.float32], Window]:
        """How far the gel's surface lies below rest, mm, and the window in which it does."""
        return self._deformer.deform(imprint.depth_mm, imprint.window, self.sensor.shape_px)
