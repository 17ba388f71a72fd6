"""A table of another image model: all that it takes is the class below."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import trimesh

from tacgen.contact.gel_response import GelLoad
from tacgen.core.errors import TableError
from tacgen.core.records import Mesh, Sensor
from tacgen.optics import LookupTable, load_table, render_rgb, save_table
from tacgen.optics.image_models import (
    ImageModel,
    Quadratic,
    base,
    register_model,
)
from tacgen.optics.reconstruct import Reconstructor
from tacgen.sensor.tactile_pad import TactilePad
from tests.messages import refused
from tests.small_world import slope_table

SENSOR = Sensor("lit", 120, 160, 0.1, 3.0)
TOWARDS = 2.0 * np.pi / 3.0 * np.arange(3)


@register_model
@dataclass(frozen=True)
class Lambert(ImageModel):
    """Three distant lamps at 30° over the gel: grey levels follow the cosine to the normal."""

    grey: float

    kind: ClassVar[str] = "lambert"

    def _colors(self, gx, gy):
        length = np.sqrt(1.0 + gx**2 + gy**2)[..., None]
        along = -(gx[..., None] * np.cos(TOWARDS) + gy[..., None] * np.sin(TOWARDS))
        level = np.sin(np.pi / 6)
        lit = (np.cos(np.pi / 6) * along + level) / length
        return self.grey * (np.maximum(lit, 0.0) - level)

    def shade(self, background, mm_per_px):
        def shaded(height_map_mm, window, spans, image):
            gy, gx = np.gradient(height_map_mm.astype(float), mm_per_px)
            lit = background + self._colors(gx, gy)
            for row, (left, right) in zip(range(*window[:2]), spans, strict=True):
                image[row, left:right] = lit[row, left:right]

        return shaded

    def slope_colors(self, gx, gy):
        colors = self._colors(gx, gy)[..., None, None, :]
        return np.broadcast_to(colors, (*gx.shape, 2, 2, 3)).copy()

    def save(self):
        return {"lamps": TOWARDS}, {"grey": self.grey}

    @classmethod
    def load(cls, arrays, numbers):
        np.testing.assert_array_equal(arrays["lamps"], TOWARDS)
        return cls(numbers["grey"])


def lambert_table(**others):
    background = np.full((*SENSOR.shape_px, 3), 100.0, np.float32)
    return LookupTable.of_model(Lambert(120.0), background, SENSOR.mm_per_px, 1.2, **others)


def tilted(gx, gy):
    """A gel that is a plane."""
    y, x = np.indices(SENSOR.shape_px) * SENSOR.mm_per_px
    return (gx * x + gy * y).astype(np.float32)


BALL = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
MESH = Mesh.fixed(BALL.vertices, BALL.faces)


def test_it_renders():
    rgb = render_rgb(tilted(0.3, -0.2), lambert_table())
    expected = 100.0 + Lambert(120.0)._colors(np.array(0.3), np.array(-0.2))
    np.testing.assert_allclose(rgb[5, 7], expected, atol=0.51)
    assert np.ptp(rgb[1:-1, 1:-1], axis=(0, 1)).max() <= 1


def test_a_pad_draws_only_what_a_contact_changes_of_it_and_its_shadows():
    for shadows in (False, True):
        pad = TactilePad(SENSOR, lambert_table(), shadows=shadows)
        imprint = pad.press(MESH, np.eye(4), GelLoad(6.0))
        deformation, (top, bottom, left, right) = pad.deformation(imprint)
        height = np.zeros(SENSOR.shape_px, np.float32)
        height[top:bottom, left:right] -= deformation
        whole = render_rgb(height, lambert_table(), shadows=shadows)
        np.testing.assert_array_equal(pad.image(imprint), whole)


def test_it_is_inverted():
    """The depth of a ball from its picture."""
    table = lambert_table()
    pad = TactilePad(SENSOR, table)
    imprint = pad.press(MESH, np.eye(4), GelLoad(6.0))
    at_rest = np.full((*SENSOR.shape_px, 3), 100, np.uint8)
    shape = Reconstructor(table, at_rest).shape_of(pad.image(imprint))
    assert shape.depth_mm.max() == pytest.approx(imprint.indentation_mm, rel=0.05)
    volume = shape.imprint(0.03).depth_mm.sum() * shape.mm_per_px**2
    assert volume == pytest.approx(imprint.volume_mm3, rel=0.08)


def test_it_is_written_and_read_in_a_section_of_its_own(tmp_path):
    made = lambert_table(sensor="lit", effects={"blur": {"sigma_mm": 0.1}})
    save_table(made, tmp_path / "table.npz")
    read = load_table(tmp_path / "table.npz")
    assert read.model == made.model
    assert read.image_model is read.model
    np.testing.assert_array_equal(read.coefficients, made.coefficients)
    height = tilted(0.1, 0.25)
    np.testing.assert_array_equal(render_rgb(height, read), render_rgb(height, made))
    # A table is the same, whichever way its model is held.
    again = replace(read, model=None)
    assert isinstance(again.image_model, Quadratic)


def test_a_table_of_an_unknown_model_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "table.npz"
    save_table(lambert_table(), path)
    monkeypatch.delitem(base._MODELS, "lambert")
    with refused(TableError):
        load_table(path)


def test_tables_of_before_are_read(tmp_path):
    """They name no model: a response, its contact or neither tells it."""
    made = slope_table((48, 64), 0.3)
    save_table(made, tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as archive:
        arrays = dict(archive)
    meta = arrays["meta"].tobytes().replace(b'"model": {"kind": "quadratic"}, ', b"")
    assert b"model" not in meta
    arrays["meta"] = np.frombuffer(meta, np.uint8)
    np.savez(tmp_path / "old.npz", **arrays)
    read = load_table(tmp_path / "old.npz")
    assert isinstance(read.image_model, Quadratic)
    np.testing.assert_array_equal(read.coefficients, made.coefficients)
