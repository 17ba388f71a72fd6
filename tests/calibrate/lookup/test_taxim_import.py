"""A Taxim table renders the same picture after import as by Taxim's own formulas."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tacgen.calibrate.lookup.taxim_import import import_polycalib
from tacgen.core.errors import TableError
from tacgen.optics import load_table, render_rgb, save_table
from tests.messages import refused


def taxim_picture_bgr(depth_px: np.ndarray, polycalib: dict, background: np.ndarray) -> np.ndarray:
    """Taxim's look-up, written from its formulas: deeper is larger, slopes in pixels."""
    rows, columns = depth_px.shape
    along_rows = (depth_px[2:, 1:-1] - depth_px[:-2, 1:-1]) / 2
    along_columns = (depth_px[1:-1, 2:] - depth_px[1:-1, :-2]) / 2
    steepness = np.hypot(along_rows, along_columns)
    magnitude = np.pad(np.arctan(steepness), 1, "symmetric")
    direction = np.zeros_like(steepness)
    sloping = steepness > 0
    direction[sloping] = np.arctan2(along_rows[sloping], along_columns[sloping])
    direction = np.pad(direction, 1, "symmetric")
    bins = int(polycalib["bins"])
    i = np.floor(magnitude / (0.5 * np.pi / (bins - 1))).astype(int)
    j = np.floor((direction + np.pi) / (2 * np.pi / (bins - 1))).astype(int)
    y, x = np.mgrid[:rows, :columns].astype(float)
    features = np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=-1)
    names = ("grad_r", "grad_g", "grad_b")
    change = np.stack([(polycalib[n][i, j] * features).sum(-1) for n in names], axis=-1)
    return np.clip(change + background, 0, 255)


def ball_depth_px(shape: tuple[int, int], x: float, y: float, radius: float, depth: float):
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(float)
    square = (columns - x) ** 2 + (rows - y) ** 2
    ball = np.sqrt(np.maximum(radius**2 - square, 0)) - (radius - depth)
    return np.maximum(ball, 0)


def some_polycalib(bins: int, shape: tuple[int, int], seed: int) -> dict:
    """A table of smooth random coefficients that stays within the scale of grey levels."""
    rng = np.random.default_rng(seed)
    height, width = shape
    scale = np.array([width**2, height**2, width * height, width, height, 1.0])
    table = {"bins": np.array(bins)}
    for name in ("grad_r", "grad_g", "grad_b"):
        coarse = rng.normal(0, 12, (6, 6, 6))
        fine = np.stack([cv2.resize(c, (bins, bins)) for c in coarse], axis=-1)
        table[name] = fine / scale
    return table


def mean_difference(tmp_path: Path, polycalib: dict, background: np.ndarray, depth_px) -> float:
    np.savez(tmp_path / "polycalib.npz", **polycalib)
    np.save(tmp_path / "bg.npy", background)
    mm_per_px = 0.1
    table = import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", mm_per_px)
    save_table(table, tmp_path / "table.npz")
    ours = render_rgb(-depth_px * mm_per_px, load_table(tmp_path / "table.npz"))
    theirs = taxim_picture_bgr(depth_px, polycalib, background)[..., ::-1]
    return float(np.abs(ours - theirs).mean())


@pytest.mark.parametrize(
    ("bins", "shape"), [(80, (120, 160)), (125, (240, 320)), (40, (97, 131)), (33, (64, 64))]
)
def test_renders_what_taxim_renders(tmp_path, bins, shape):
    polycalib = some_polycalib(bins, shape, seed=bins)
    background = np.full((*shape, 3), [100.0, 120.0, 140.0])
    depth = ball_depth_px(shape, 0.4 * shape[1], 0.55 * shape[0], 20, 9)
    # Half a grey level is what rounding to 8 bits alone may come to.
    assert mean_difference(tmp_path, polycalib, background, depth) <= 0.5


def test_a_tilted_gel_renders_what_taxim_renders(tmp_path):
    shape = (90, 110)
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(float)
    polycalib = some_polycalib(80, shape, seed=5)
    background = np.full((*shape, 3), 127.0)
    depth = 0.31 * columns + 0.17 * rows + 3 * np.sin(columns / 9) * np.cos(rows / 7)
    assert mean_difference(tmp_path, polycalib, background, depth) <= 0.5


def test_the_measured_table(tmp_path, measured_data):
    folder = measured_data / "taxim_table"
    with np.load(folder / "polycalib_small.npz") as archive:
        polycalib = dict(archive)
    background = np.load(folder / "real_bg_small.npy")
    depth = ball_depth_px((120, 160), 83.3, 61.7, 17, 7)
    assert mean_difference(tmp_path, polycalib, background, depth) <= 0.5


def test_what_is_wrong_is_said(tmp_path):
    with refused(TableError):
        import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.1)
    np.savez(tmp_path / "polycalib.npz", bins=4, grad_r=np.zeros((4, 4, 6)))
    with refused(TableError):
        import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.1)
    np.savez(
        tmp_path / "polycalib.npz",
        grad_r=np.zeros((4, 4, 5)),
        grad_g=np.zeros((4, 4, 6)),
        grad_b=np.full((4, 4, 6), np.nan),
    )
    with refused(TableError):
        import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.1)
    with refused(TableError):
        import_polycalib(tmp_path / "polycalib.npz", tmp_path / "bg.npy", 0.0)


def test_the_background_may_be_that_of_a_datapack(tmp_path):
    np.savez(tmp_path / "polycalib.npz", **some_polycalib(20, (30, 40), seed=1))
    f0 = np.full((30, 40, 3), [10, 20, 30], np.uint8)
    np.savez(tmp_path / "dataPack.npz", f0=f0, imgs=f0[None])
    table = import_polycalib(tmp_path / "polycalib.npz", tmp_path / "dataPack.npz", 0.1)
    assert table.background[0, 0].tolist() == [30.0, 20.0, 10.0]
    np.savez(tmp_path / "other.npz", imgs=f0[None])
    with refused(TableError):
        import_polycalib(tmp_path / "polycalib.npz", tmp_path / "other.npz", 0.1)
