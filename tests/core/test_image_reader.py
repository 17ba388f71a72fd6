"""One reader of pictures: equal pictures however they are stored, or a refusal that says why."""

import io

import cv2
import numpy as np
import pytest
from PIL import Image

from tacgen.core.errors import TacgenError
from tacgen.core.safe_io import read_rgb, rgb_of_array
from tests.messages import refused

RGB = np.random.default_rng(0).integers(20, 236, (24, 32, 3)).astype(np.uint8)
BRIGHT = RGB.copy()
BRIGHT[0, 0] = 250  # what a 16-bit picture needs to show that its range is used


def write(path, values):
    """RGB, RGBA or grey values of any type, by OpenCV, which keeps the type."""
    if values.ndim == 3:
        values = values[..., [2, 1, 0, 3][: values.shape[2]]]
    assert cv2.imwrite(str(path), np.ascontiguousarray(values))
    return path


@pytest.mark.parametrize(
    ("stored", "wanted", "off"),
    [
        (BRIGHT, BRIGHT, 0),
        (BRIGHT.astype(np.uint16) * 257, BRIGHT, 0),
        (RGB.astype(np.uint16) * 256, RGB, 0),
        (BRIGHT.astype(np.uint16) * 257 + 100, BRIGHT, 1),  # rounding, at most one level
        (np.dstack([BRIGHT, np.full(BRIGHT.shape[:2], 255, np.uint8)]), BRIGHT, 0),
    ],
    ids=["8", "16", "upper byte", "16 full", "opaque"],
)
def test_what_is_sure_is_scaled(tmp_path, stored, wanted, off):
    found = read_rgb(write(tmp_path / "a.png", stored))
    assert found.dtype == np.uint8
    assert np.abs(found.astype(int) - wanted).max() <= off


@pytest.mark.parametrize(
    "stored",
    [
        BRIGHT.astype(np.uint16) * 4,
        BRIGHT.astype(np.uint16) * 16,
        BRIGHT.astype(np.uint16),
        BRIGHT[..., 0].astype(np.uint16) * 100,
        np.dstack([BRIGHT, BRIGHT[..., 0]]),
    ],
    ids=["10 bits", "12 bits", "8 bits below", "depth", "alpha"],
)
def test_what_is_not_sure_is_refused_with_type_and_range(tmp_path, stored):
    with refused(TacgenError):
        read_rgb(write(tmp_path / "a.png", stored))


def test_depth_in_floats_and_masks_are_refused(tmp_path):
    write(tmp_path / "depth.tiff", np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4))
    with refused(TacgenError):
        read_rgb(tmp_path / "depth.tiff")
    Image.fromarray(RGB[..., 0] > 100).save(tmp_path / "mask.png")
    with refused(TacgenError):
        read_rgb(tmp_path / "mask.png")


def test_several_pictures_in_a_file_are_refused(tmp_path):
    first, second = Image.fromarray(RGB), Image.fromarray(BRIGHT)
    first.save(tmp_path / "a.gif", save_all=True, append_images=[second])
    with refused(TacgenError):
        read_rgb(tmp_path / "a.gif")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["PNG", "TIFF"])
def test_a_turn_by_exif_is_made_as_other_readers_make_it(tmp_path, capsys, orientation, kind):
    exif = Image.Exif()
    exif[0x0112] = orientation
    path = tmp_path / f"a.{kind.lower()}"
    Image.fromarray(RGB).save(path, exif=exif)
    from PIL import ImageOps

    upright = np.asarray(ImageOps.exif_transpose(Image.open(path)))
    np.testing.assert_array_equal(read_rgb(path), upright)
    said = f"EXIF orientation {orientation}" in capsys.readouterr().err
    assert said == (orientation != 1 and kind == "PNG")


@pytest.mark.parametrize(("quality", "said"), [(70, True), (95, False)])
def test_coarse_jpeg_and_palettes_are_said(tmp_path, capsys, quality, said):
    Image.fromarray(RGB).save(tmp_path / "a.jpg", quality=quality)
    read_rgb(tmp_path / "a.jpg")
    assert ("JPEG below quality 90" in capsys.readouterr().err) == said
    Image.fromarray(RGB).quantize(64).save(tmp_path / "p.png")
    assert read_rgb(tmp_path / "p.png").shape == RGB.shape
    assert "palette" in capsys.readouterr().err


def test_grey_is_repeated_and_said(tmp_path, capsys):
    found = read_rgb(write(tmp_path / "a.png", RGB[..., 1]))
    np.testing.assert_array_equal(found, np.repeat(RGB[..., 1:2], 3, axis=2))
    assert "one grey channel" in capsys.readouterr().err


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.float16])
def test_floats_of_0_to_1_and_of_0_to_255_are_the_same_picture(dtype):
    # Half precision keeps 11 bits: half a grey level of 255.
    np.testing.assert_array_equal(rgb_of_array((RGB / 255).astype(dtype), "a"), RGB)
    np.testing.assert_array_equal(rgb_of_array(RGB.astype(dtype), "a"), RGB)
    np.testing.assert_array_equal(rgb_of_array(RGB.astype(np.int64), "a"), RGB)


@pytest.mark.parametrize(
    "values",
    [RGB / 128.0 - 1.0, RGB * 4.0, np.full((4, 4, 3), np.nan), RGB.astype(int) - 30, RGB / 20.0],
    ids=["-1 to 1", "0 to 1000", "nan", "negative", "0 to 12"],
)
def test_other_arrays_are_refused(values):
    with refused(TacgenError):
        rgb_of_array(values, "a")


def test_a_damaged_file_is_no_image(tmp_path):
    buffer = io.BytesIO()
    Image.fromarray(RGB).save(buffer, "PNG")
    (tmp_path / "a.png").write_bytes(buffer.getvalue()[:40])
    with refused(TacgenError):
        read_rgb(tmp_path / "a.png")


@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
@pytest.mark.parametrize("share", [0.5, 0.9, 0.999])
def test_a_file_cut_short_is_said_without_a_decoders_words(tmp_path, capfd, kind, share):
    buffer = io.BytesIO()
    Image.fromarray(RGB).resize((200, 150)).save(buffer, kind, quality=95)
    whole, path = buffer.getvalue(), tmp_path / f"a.{kind.lower()}"
    path.write_bytes(whole)
    assert read_rgb(path).shape == (150, 200, 3)
    path.write_bytes(whole[: int(share * len(whole))])
    with refused(TacgenError):
        read_rgb(path)
    assert capfd.readouterr().err == ""


def test_a_flipped_bit_in_a_png_is_said(tmp_path, capfd):
    buffer = io.BytesIO()
    Image.fromarray(RGB).save(buffer, "PNG")
    data = bytearray(buffer.getvalue())
    data[len(data) // 2] ^= 16
    (tmp_path / "a.png").write_bytes(data)
    with refused(TacgenError):
        read_rgb(tmp_path / "a.png")
    assert capfd.readouterr().err == ""
