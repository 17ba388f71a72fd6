"""Press folders and dataPacks: what is read, and what is said when they are wrong."""

import re

import cv2
import numpy as np
import pytest

from tacgen.core.errors import PressError, TacgenError
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses
from tests.virtual_presses import virtual_presses


def write_folder(folder, presses, *, columns=("file", "radius_mm"), drop=()):
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "background.png"), presses.background[..., ::-1])
    lines = [",".join(columns)]
    for k, name in enumerate(presses.names):
        cv2.imwrite(str(folder / name), presses.images[k][..., ::-1])
        values = {
            "file": name,
            "radius_mm": f"{presses.ball_radius_mm[k]}",
            "center_x_px": f"{presses.center_px[k, 0]:.3f}",
            "center_y_px": f"{presses.center_px[k, 1]:.3f}",
            "contact_radius_px": f"{presses.radius_px[k]:.3f}",
        }
        lines.append(",".join(values[c] for c in columns))
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "sensor.yaml").write_text(f"name: test\nmm_per_px: {presses.mm_per_px}\n")
    for name in drop:
        (folder / name).unlink()
    return folder


@pytest.fixture(scope="module")
def presses():
    return virtual_presses(1, count=6)


ALL = ("file", "radius_mm", "center_x_px", "center_y_px", "contact_radius_px")


def test_a_folder_is_read_as_it_was_written(tmp_path, presses):
    read = read_presses(write_folder(tmp_path / "p", presses, columns=ALL))
    assert np.array_equal(read.images, presses.images)
    assert np.array_equal(read.background, presses.background)
    assert read.center_px == pytest.approx(presses.center_px, abs=1e-3)
    assert read.labelled.all()
    assert read.mm_per_px == presses.mm_per_px


def test_a_list_may_have_decimal_commas(tmp_path, presses):
    """As a spreadsheet writes it in half of Europe."""
    folder = write_folder(tmp_path / "p", presses, columns=ALL)
    plain = read_presses(folder)
    text = (folder / "presses.csv").read_text().replace(",", ";")
    (folder / "presses.csv").write_text(re.sub(r"(?<=\d)\.(?=\d)", ",", text))
    read = read_presses(folder)
    np.testing.assert_array_equal(read.center_px, plain.center_px)
    np.testing.assert_array_equal(read.ball_radius_mm, plain.ball_radius_mm)


@pytest.mark.parametrize("background", ["background.png", "background.jpg", "Background.JPEG"])
def test_a_folder_of_pictures_needs_no_list(tmp_path, presses, background):
    folder = tmp_path / "p"
    folder.mkdir()
    cv2.imwrite(str(folder / background), presses.background[..., ::-1])
    for k, image in enumerate(presses.images):
        cv2.imwrite(str(folder / f"ball {k}.{('png', 'jpg', 'JPEG')[k % 3]}"), image[..., ::-1])
    (folder / "notes.txt").write_text("taken in the morning")
    (folder / "._ball 0.png").write_bytes(b"of another system")
    read = read_presses(folder, mm_per_px=presses.mm_per_px, ball_radius_mm=3.0)
    assert read.names == tuple(f"ball {k}.{('png', 'jpg', 'JPEG')[k % 3]}" for k in range(6))
    assert np.array_equal(read.images[0], presses.images[0])
    assert np.abs(read.background.astype(int) - presses.background).mean() < 3.0
    assert set(read.ball_radius_mm) == {3.0}
    assert np.isnan(read.center_px).all()
    assert set(read.sha256) == {background, *read.names}


def test_a_folder_of_pictures_asks_for_the_ball_and_the_scale(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses, drop=("presses.csv", "sensor.yaml"))
    with pytest.raises(PressError) as error:
        read_presses(folder)
    text = str(error.value)
    assert "presses.csv: missing; list the presses in it: file, radius_mm; or give --ball" in text
    assert "sensor.yaml: missing; write `mm_per_px: <size of a pixel>` into it, or give" in text
    with pytest.raises(PressError, match=r"radius_mm = 4000 is not a ball's"):
        read_presses(folder, mm_per_px=0.1, ball_radius_mm=4000)


def test_a_datapack_is_bgr(tmp_path, presses):
    np.savez(
        tmp_path / "dataPack.npz",
        f0=presses.background[..., ::-1],
        imgs=presses.images[..., ::-1],
        touch_center=presses.center_px,
        touch_radius=presses.radius_px,
        names=np.array(["a", 1, 2, 3, 4, None], dtype=object),
        img_size=np.array(presses.images.shape[1:]),
    )
    read = read_presses(tmp_path / "dataPack.npz", mm_per_px=0.2, ball_radius_mm=3.0)
    assert np.array_equal(read.images, presses.images)
    assert read.mm_per_px == 0.2
    assert set(read.ball_radius_mm) == {3.0}
    assert read.names[0] == "imgs[0]"  # names as Python objects are not unpickled


def test_every_missing_file_is_said_at_once(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses, drop=("background.png", "sensor.yaml", "2.png"))
    with pytest.raises(PressError) as error:
        read_presses(folder)
    text = str(error.value)
    assert "background.png: missing" in text
    assert "sensor.yaml: missing; write `mm_per_px" in text
    assert "2.png: missing (row 4 of presses.csv)" in text


def test_a_missing_column_names_the_mend(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses, columns=("file",))
    with pytest.raises(PressError, match="column 'radius_mm' is missing; add it"):
        read_presses(folder)


def test_wrong_cells_name_their_row(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses)
    (folder / "presses.csv").write_text("file,radius_mm\n0.png,two\n1.png,\n1.png,2.0\n")
    with pytest.raises(PressError) as error:
        read_presses(folder)
    text = str(error.value)
    assert "row 2: radius_mm = 'two' is not a number" in text
    assert "row 3: radius_mm is empty" in text
    assert "row 4: 1.png is listed twice" in text


def test_images_of_unequal_size(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses)
    cv2.imwrite(str(folder / "3.png"), np.zeros((10, 20, 3), np.uint8))
    with pytest.raises(PressError, match=r"3.png: \(row 5\) is 20×10 px, the background 128×96"):
        read_presses(folder)


def test_a_press_with_no_contact_is_left_out_and_said(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses)
    cv2.imwrite(str(folder / "4.png"), presses.background[..., ::-1])
    used = usable_presses(read_presses(folder))
    assert len(used) == 5
    assert "4.png (row 6): shows no contact; dropped" in str(used.dropped[0])


def test_what_is_certain_drops_a_press_and_what_is_odd_warns(presses):
    from dataclasses import replace

    images, center, radius = (
        presses.images.copy(),
        presses.center_px.copy(),
        presses.radius_px.copy(),
    )
    rows, columns = np.indices(presses.shape_px)
    disc = np.hypot(columns - center[0, 0], rows - center[0, 1]) < radius[0]
    images[0][disc] = 255
    left = round(center[1, 0])  # to the picture's edge
    change = images[1].astype(int) - presses.background
    change = np.concatenate([change[:, left:], np.zeros_like(change[:, :left])], axis=1)
    images[1] = np.clip(presses.background + change, 0, 255)
    center[1, 0] = 0.0
    radius[2] = 60.0
    given = replace(presses, images=images, center_px=center, radius_px=radius)
    used = usable_presses(given)
    assert [press.file for press in used.dropped] == ["0.png"]
    assert "0.png (row 2): 100% of its contact is saturated" in str(used.dropped[0])
    warnings = "\n".join(used.warnings)
    assert re.search(r"1.png \(row 3\): [45]\d% of its contact lies out of view", warnings)
    # A label that contradicts the ball is replaced by what is seen.
    assert "2.png (row 4): the labelled contact radius of 60.0 px is over" in warnings
    assert used.radius_px[1] == pytest.approx(presses.radius_px[2], rel=0.15)
    scored = usable_presses(given, least=1, every=True)
    assert len(scored) == len(presses)
    assert "0.png (row 2): 100% of its contact is saturated; counted" in "\n".join(scored.warnings)


def test_copies_are_left_out_and_labels_of_something_else_replaced(presses):
    from dataclasses import replace

    images, center = presses.images.copy(), presses.center_px.copy()
    images[5], center[5] = images[0], center[0]
    # Labelled half way off the contact: its rim still changes there.
    center[3] += [0.9 * presses.radius_px[3], 0.0]
    used = usable_presses(replace(presses, images=images, center_px=center))
    assert "5.png (row 7): is the same picture as 0.png; dropped: list each press once" in str(
        used.dropped[0]
    )
    assert "3.png (row 5): its labelled centre is " in "\n".join(used.warnings)
    assert len(used) == 5
    assert np.hypot(*(used.center_px[3] - presses.center_px[3])) < 0.2 * presses.radius_px[3]


def test_a_label_where_nothing_is_seen_contradicts_the_picture(presses):
    from dataclasses import replace

    images = presses.images.copy()
    images[4] = presses.background
    used = usable_presses(replace(presses, images=images))
    assert "4.png (row 6): its labelled circle shows no contact" in str(used.dropped[0])


def test_radius_and_scale_in_another_unit(tmp_path, presses):
    folder = write_folder(tmp_path / "p", presses)
    text = (folder / "presses.csv").read_text().replace(",2.0", ",2000")
    (folder / "presses.csv").write_text(text)
    (folder / "sensor.yaml").write_text("mm_per_px: 140.0\n")
    with pytest.raises(PressError) as error:
        read_presses(folder)
    assert "row 2: radius_mm = 2000 is not a ball's; give the" in str(error.value)
    assert "mm_per_px = 140 makes the picture 1.79e+04 mm wide" in str(error.value)


def test_grey_pictures_are_said(presses):
    from dataclasses import replace

    def grey(image):
        return np.repeat(image[..., :1], 3, axis=-1)

    used = usable_presses(
        replace(presses, images=grey(presses.images), background=grey(presses.background))
    )
    assert "the pictures are grey" in "\n".join(used.warnings)


def shifted(image, columns):
    """The picture of another crop."""
    return np.roll(image, columns, axis=1)


@pytest.mark.parametrize(
    ("background", "message"),
    [
        (lambda made: shifted(made.background, 40), "does not match the presses: the bare gel"),
        (lambda made: made.background[..., ::-1], "red and blue are swapped"),
        (lambda made: made.images[0], r"shows a contact at \(.*\): it is a press itself"),
    ],
)
def test_a_background_that_is_not_of_these_presses(background, message):
    from dataclasses import replace

    made = virtual_presses(21, count=12)
    usable_presses(made)
    with pytest.raises(PressError, match=message):
        usable_presses(replace(made, background=np.ascontiguousarray(background(made))))


def test_pictures_of_two_sensors_in_one_folder():
    from dataclasses import replace

    made = virtual_presses(22, count=12)
    images = made.images.copy()
    images[:4] = np.rot90(images[:4], 2, axes=(1, 2))
    used = usable_presses(replace(made, images=images))
    assert [press.file for press in used.dropped] == ["0.png", "1.png", "2.png", "3.png"]
    assert "does not match the background: it is turned by 180°" in str(used.dropped[0])
    images = np.rot90(made.images, 2, axes=(1, 2)).copy()
    images[:4] = made.images[:4]
    with pytest.raises(PressError, match="not match the presses: it is turned by 180°"):
        usable_presses(replace(made, images=images))


def test_lamps_that_drift_over_the_picture_hide_no_contact():
    """As much as the contact itself changes, from picture to picture and over each picture."""
    from dataclasses import replace

    made = virtual_presses(23, count=8, labelled=False)
    truth = virtual_presses(23, count=8)
    rng = np.random.default_rng(24)
    height, width = made.shape_px
    v, u = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    images = [
        np.clip(image + 12 * (a * u * v + b * u * u + c * v)[..., None], 0, 255).astype(np.uint8)
        for image, (a, b, c) in zip(made.images, rng.uniform(-1, 1, (8, 3)), strict=True)
    ]
    used = usable_presses(replace(made, images=np.stack(images)))
    apart = np.hypot(*(used.center_px - truth.center_px).T)
    assert (apart < 0.25 * truth.radius_px).all()


def test_fewer_than_three_presses(presses):
    with pytest.raises(PressError, match="2 usable presses, at least 3 are needed"):
        usable_presses(presses.select(np.arange(2)))


def test_nothing_there(tmp_path):
    with pytest.raises(PressError, match="there are no presses"):
        read_presses(tmp_path / "nowhere")
    (tmp_path / "x.npz").write_bytes(b"not a zip")
    with pytest.raises(PressError, match="cannot be read as a dataPack"):
        read_presses(tmp_path / "x.npz")
    with pytest.raises(TacgenError, match="mm_per_px = -1 must be a positive number"):
        read_presses(tmp_path / "x.npz", mm_per_px=-1.0)


def test_labels_stand_where_a_camera_clips_most_of_the_contact(presses):
    from dataclasses import replace

    # Half of the contact is as bright as a camera can show, and so is the bare gel around it.
    rows, columns = np.mgrid[: presses.shape_px[0], : presses.shape_px[1]]
    level = 120
    images = np.full_like(presses.images, level)
    center = presses.center_px.copy()
    for k, (radius, image) in enumerate(zip(presses.radius_px, images, strict=True)):
        away = np.hypot(columns - center[k, 0], rows - center[k, 1])
        image[away < 0.6 * radius] = 60 + k
        center[k] += [0.8 * radius, 0.0]
    background = np.full_like(presses.background, level)
    clipped = replace(presses, images=images, background=background, center_px=center)
    assert len(usable_presses(clipped)) == len(presses)
    brighter = images.copy()
    brighter[:, 0, 0] = 255  # the camera shows more than that
    used = usable_presses(replace(clipped, images=brighter))
    assert "its labelled centre is" in "\n".join(used.warnings)
    assert used.found.all()
