"""A table in Taxim's form renders in Taxim what it renders here."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import tacgen
from tacgen.calibrate.lookup.taxim_export import export_taxim, taxim_coefficients
from tacgen.calibrate.lookup.taxim_import import import_polycalib
from tacgen.cli import app
from tacgen.contact.gel import gel_map_mm
from tacgen.core.errors import TacgenError
from tacgen.optics import load_table, render_rgb, save_table
from tacgen.optics.deform import deform
from tests.calibrate.lookup.test_taxim_import import (
    ball_depth_px,
    some_polycalib,
    taxim_picture_bgr,
)
from tests.messages import refused


def surface_mm(shape, mm_per_px, x, y):
    depth_px = ball_depth_px(shape, x * shape[1], y * shape[0], 0.15 * shape[0], 0.06 * shape[0])
    return -deform(depth_px * mm_per_px, mm_per_px)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The coefficients of the shipped DIGIT's table, of Taxim's form, and their export."""
    table = load_table(tacgen.Sensor("digit").description.table)
    table = replace(table, response=None, contact=None)
    folder = tmp_path_factory.mktemp("export") / "taxim"
    return table, folder, export_taxim(table, folder)


def test_taxims_own_table_comes_back(tmp_path):
    polycalib = some_polycalib(33, (48, 64), seed=3)
    np.savez(tmp_path / "polycalib.npz", **polycalib)
    np.save(tmp_path / "bg.npy", np.full((48, 64, 3), 120.0))
    table = import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.1)
    back = taxim_coefficients(table, tacgen.Sensor("digit").description)
    for channel, name in enumerate(("grad_b", "grad_g", "grad_r")):
        # In float32, and without the last direction, which is met at exactly π alone.
        scale = np.abs(polycalib[name]).max(axis=(0, 1))
        np.testing.assert_allclose(
            back[:, :-1, channel] / scale, polycalib[name][:, :-1] / scale, atol=1e-5
        )


@pytest.mark.slow
def test_taxims_formulas_render_what_the_table_renders(exported):
    table, folder, loss = exported
    with np.load(folder / "polycalib.npz") as archive:
        polycalib = dict(archive)
    with np.load(folder / "dataPack.npz") as archive:
        background = archive["f0"]
    rest = gel_map_mm(tacgen.Sensor("digit").description)
    for x, y in ((0.5, 0.5), (0.31, 0.63)):
        surface = rest + surface_mm(table.shape_px, table.mm_per_px, x, y)
        theirs = taxim_picture_bgr(-surface / table.mm_per_px, polycalib, background)[..., ::-1]
        ours = render_rgb(surface, table)
        pressed = rest - surface > 0.05
        assert np.abs(theirs - ours).mean() <= 0.5  # 8 bits of the background and of the picture
        assert np.sqrt(np.square(theirs - ours)[pressed].mean()) <= 2 * loss.contact_grey + 0.5
    assert loss.contact_grey <= 0.1 * loss.of_contact


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_package_taxim_renders_what_the_form_renders(exported):
    """The deformation is made the identity, so that both render the same surface."""
    pytest.importorskip("jax")
    taxim = pytest.importorskip("taxim")
    table, folder, _ = exported
    height, width = table.shape_px
    none = [0.01 / width, 0.01 / height]
    smooth = {"deform_pyramid_sigma_rel": [[side] for side in none], "deform_final_sigma_rel": none}
    client = taxim.Taxim(folder, params={"simulator": smooth}, backend="jax")
    surface = surface_mm(table.shape_px, table.mm_per_px, 0.4, 0.6)
    theirs = 255 * client.render(surface.astype(np.float32), with_shadow=False)
    with np.load(folder / "dataPack.npz") as archive:
        np.save(folder.parent / "f0.npy", archive["f0"])
    form = import_polycalib(folder / "polycalib.npz", folder.parent / "f0.npy", table.mm_per_px)
    pressed = surface < -0.05
    assert np.abs(theirs - render_rgb(surface, form))[pressed].mean() <= 1
    assert np.abs(theirs - render_rgb(surface, table))[pressed].mean() <= 2
    shadowed = taxim.Taxim(folder, backend="jax").render(
        surface.astype(np.float32), with_shadow=True, press_depth=0.5
    )
    assert np.isfinite(shadowed).all()


def test_the_command_says_what_the_form_loses(tmp_path):
    polycalib = some_polycalib(20, (48, 64), seed=5)
    np.savez(tmp_path / "polycalib.npz", **polycalib)
    np.save(tmp_path / "bg.npy", np.full((48, 64, 3), 120.0))
    table = import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.1)
    save_table(table, tmp_path / "table.npz")
    arguments = ["calibrate", "export", str(tmp_path / "table.npz"), "--out", str(tmp_path / "t")]
    run = CliRunner().invoke(app, arguments)
    assert run.exit_code == 0, run.output
    assert "Taxim's form is 0.00 grey (RMSE) from the table" in run.output
    names = {"polycalib.npz", "dataPack.npz", "gelmap.npy", "shadowTable.npz", "params.json"}
    assert {path.name for path in (tmp_path / "t").iterdir()} == names
    with refused(TacgenError):
        export_taxim(table, Path(tmp_path / "t"))
