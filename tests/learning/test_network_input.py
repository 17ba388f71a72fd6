"""What the network sees: frames, size, difference, scale, augmentation, batches."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from tacgen.learning.grasps import RealGraspImages, SimulatedGrasps
from tacgen.learning.loader import Batches, DecodedInputs
from tacgen.learning.network_input import (
    InputSpec,
    augmented,
    chosen_frames,
    pressed_frame,
    read_input,
    resized,
    to_network,
    with_normalisation,
)
from tacgen.learning.training_recipe import Augmentation
from tests.learning.conftest import REFERENCE, SENSOR, write_real

SINGLE = InputSpec("single", (24, 32), 1, "difference", SENSOR.shape_px)
SEQUENCE = replace(SINGLE, kind="sequence", n_frames=3)


def test_a_single_image_is_that_of_the_moment_of_grasp():
    assert chosen_frames(SINGLE, 24, 7) == [7]
    assert chosen_frames(SINGLE, 1, -1) == [0]


def test_a_sequence_shows_by_itself_when_it_is_grasped():
    """Rest, closing, grasped, then a slip that changes a little more, then let go."""
    rest = np.full((6, 8, 3), 100, np.uint8)
    frames = np.stack([np.full_like(rest, level) for level in (100, 104, 120, 121, 100)])
    assert pressed_frame(frames, rest) == 2
    slipping = np.stack([np.full_like(rest, level) for level in (100, 116, 115, 124, 128)])
    assert pressed_frame(slipping, rest) == 1
    ramp = 100 + np.minimum(np.arange(80), 40)  # a gripper that closes for half of the sequence
    slow = np.stack([np.full_like(rest, level) for level in ramp])
    assert 36 <= pressed_frame(slow, rest) <= 40
    assert pressed_frame(frames[:1], rest) == 0


@pytest.mark.parametrize("background", [True, False])
def test_networks_of_single_images_find_the_moment_in_sequences(tmp_path, background):
    """Grippers close for as long as the object's width asks for."""
    real = RealGraspImages(write_real(tmp_path / "real", n_frames=3, background=background))
    found = read_input(real, 1, replace(SINGLE, size_px=SENSOR.shape_px))
    assert (found == real.frames(1, [2])).all()


def test_change_is_since_the_frame_before_and_the_sum_of_changes_is_the_difference():
    frames = np.random.default_rng(2).integers(0, 256, (2, 4, *SENSOR.shape_px, 3), dtype=np.uint8)
    frames[:, 3] = frames[:, 2]
    changes = to_network(frames, REFERENCE, replace(SEQUENCE, image="change"))
    assert not changes[:, 3].any()
    whole = to_network(frames, REFERENCE, SEQUENCE)
    np.testing.assert_allclose(changes.cumsum(axis=1), whole, atol=1e-3)  # float32 sums
    np.testing.assert_array_equal(changes[:, :1], whole[:, :1], err_msg="a single image")


def test_resizing_keeps_the_mean_of_an_image():
    image = np.random.default_rng(0).integers(0, 256, (1, 48, 64, 3), dtype=np.uint8)
    small = resized(image, (24, 32))
    assert small.shape == (1, 24, 32, 3)
    # The mean of four whole numbers, rounded half up, is 1/8 too high on average.
    assert small.mean() == pytest.approx(image.mean() + 1 / 8, abs=0.05)
    np.testing.assert_array_equal(
        resized(image, (48, 64)), image, err_msg="the size it has already"
    )


def test_normalised_training_images_have_mean_0_and_spread_1():
    rng = np.random.default_rng(1)
    inputs = [rng.integers(60, 180, (3, 24, 32, 3), dtype=np.uint8) for _ in range(5)]
    reference = resized(REFERENCE[None], (24, 32))[0]
    spec = with_normalisation(SEQUENCE, inputs, reference)
    images = to_network(np.stack(inputs), reference, spec).reshape(-1, 3)
    # float32 sums of some ten thousand numbers
    np.testing.assert_allclose(images.mean(0), 0, atol=1e-4)
    np.testing.assert_allclose(images.std(0), 1, atol=1e-4)


@pytest.mark.parametrize("image", ["difference", "change"])
def test_normalised_input_is_the_same_for_other_gains_and_contrasts(image):
    """A patch on less than half of the image, seen by a camera of other gain and fainter lamps.

    Their spreads differ by the constant added to the contrast (1 grey level in some 12 and 6, by
    which the images are divided), their pixels by rounding: 0.3 of some 6 grey levels.
    """
    spec = replace(SEQUENCE, image=image, normalised=True)
    rest = np.random.default_rng(0).integers(80, 140, (24, 32, 3)).astype(float)
    imprint = np.zeros((3, 24, 32, 3))
    imprint[1, 6:12, 8:20], imprint[2, 6:14, 8:22] = 20, (40, 30, -35)
    seen = np.rint(rest + imprint)
    other = np.rint((rest + imprint / 2) * (1.2, 0.9, 1.05))
    bright, faint = (
        to_network(np.stack([frames]).astype(np.uint8), rest.astype(np.uint8), spec)
        for frames in (seen, other)
    )
    assert bright[0, 1:].std() > 0.3
    assert np.abs(bright - faint * bright.std() / faint.std()).mean() < 0.05
    assert faint.std() / bright.std() == pytest.approx(1, abs=0.12)


def test_an_image_of_the_gel_at_rest_is_not_amplified_by_normalising():
    spec = replace(SINGLE, normalised=True)
    assert not to_network(REFERENCE[None, None], REFERENCE, spec).any()
    black = to_network(np.zeros_like(REFERENCE)[None, None], REFERENCE, spec)
    assert np.isfinite(black).all()


STILL = {"gain_relative": 0, "imprint_relative": 0, "noise_grey": 0, "blur_px": 0}


def test_gain_and_contrast_of_the_imprint_differ_by_colour_as_asked():
    """The standard deviation of 2000 draws is within 8 % of the one asked for (5 σ of it)."""
    rest = np.full((2, 2, 3), 100, np.uint8)
    frames = np.stack([rest, rest + 100])
    options = Augmentation(on=True, **{**STILL, "shift_fraction": 0, "gain_relative": 0.05})
    seen = np.stack(
        [
            augmented(frames, rest, options, np.random.default_rng(k))[:, 0, 0].astype(float)
            for k in range(2000)
        ]
    )
    assert (seen[:, 0] / 100).std(axis=0) == pytest.approx([0.05] * 3, rel=0.08)
    assert abs(np.corrcoef(seen[:, 0, 0], seen[:, 0, 1])[0, 1]) < 0.12
    options = Augmentation(on=True, **{**STILL, "shift_fraction": 0, "imprint_relative": 0.15})
    seen = np.stack(
        [
            augmented(frames, rest, options, np.random.default_rng(k))[:, 0, 0].astype(float)
            for k in range(2000)
        ]
    )
    np.testing.assert_array_equal(seen[:, 0], 100)
    assert ((seen[:, 1] - 100) / 100).std(axis=0) == pytest.approx([0.15] * 3, rel=0.08)


def test_augmentation_moves_all_frames_of_a_grasp_alike_and_leaves_its_input():
    frames = np.zeros((2, 24, 32, 3), np.uint8)
    frames[:, 12, 16] = 200
    before = frames.copy()
    options = Augmentation(on=True, shift_fraction=0.25, **STILL)
    moved = augmented(frames, None, options, np.random.default_rng(3))
    np.testing.assert_array_equal(frames, before)
    np.testing.assert_array_equal(moved[0], moved[1])
    ys, xs = np.nonzero(moved[0, ..., 0])
    assert len(ys) == 1
    assert (ys[0], xs[0]) != (12, 16)
    assert abs(ys[0] - 12) <= 6
    assert abs(xs[0] - 16) <= 8


def test_a_shift_moves_the_imprint_and_not_the_light_of_the_gel():
    rng = np.random.default_rng(0)
    rest = rng.integers(60, 120, (24, 32, 3), dtype=np.uint8)
    imprint = np.zeros((24, 32, 3), np.uint8)
    imprint[10:14, 12:18] = rng.integers(20, 90, (4, 6, 3))
    options = Augmentation(on=True, shift_fraction=0.2, **STILL)
    pressed, unpressed = augmented(
        np.stack([rest + imprint, rest]), rest, options, np.random.default_rng(4)
    )
    np.testing.assert_array_equal(unpressed, rest)
    ys, xs = np.nonzero((pressed - rest).any(axis=2))
    assert (ys.min(), xs.min()) != (10, 12)
    moved = (pressed - rest)[ys.min() : ys.max() + 1, xs.min() : xs.max() + 1]
    np.testing.assert_array_equal(moved, imprint[10:14, 12:18])


@pytest.fixture(scope="module")
def source(toy) -> SimulatedGrasps:
    return SimulatedGrasps(toy)


def batches_of(source, spec=SEQUENCE, cache_mb=64, n=9, size=4) -> Batches:
    inputs = DecodedInputs(source, np.arange(n), spec, cache_mb)
    return Batches(inputs, spec, REFERENCE, size)


def test_batches_are_the_same_from_memory_and_from_disk(source):
    expected = list(batches_of(source).in_order())
    assert [len(labels) for _, labels, _ in expected] == [4, 4, 1]
    assert expected[0][0].shape == (4, 3, 3, 24, 32)
    found = list(batches_of(source, cache_mb=0).in_order())
    for (images, labels, items), (images_2, labels_2, items_2) in zip(expected, found, strict=True):
        assert torch.equal(images, images_2)
        assert torch.equal(labels, labels_2)
        assert np.array_equal(items, items_2)


def test_the_order_depends_on_seed_and_epoch_and_holds_each_grasp_once(source):
    batches = batches_of(source)
    off = Augmentation()

    def order(seed: int, epoch: int) -> list[int]:
        return [int(i) for _, _, items in batches.shuffled(seed, epoch, off) for i in items]

    orders = {key: order(*key) for key in itertools.product((1, 2), (1, 2))}
    assert all(sorted(found) == list(range(9)) for found in orders.values())
    assert len({tuple(found) for found in orders.values()}) == 4
    assert order(1, 2) == orders[1, 2]


def test_augmentation_is_drawn_anew_each_epoch_and_repeatably(source):
    batches = batches_of(source, n=4)
    on = Augmentation(on=True)

    def image_of(epoch: int) -> torch.Tensor:
        images, _, items = next(batches.shuffled(5, epoch, on))
        return images[list(items).index(0)]

    assert torch.equal(image_of(1), image_of(1))
    assert not torch.equal(image_of(1), image_of(2))


def test_a_short_sequence_is_as_long_whatever_stands_beside_it(source):
    """Else a grasp's answer would hang on its neighbours in the batch."""
    spec = replace(SEQUENCE, n_frames=7)
    for size in (1, 4):
        lengths = {
            images.shape[1] for images, _, _ in batches_of(source, spec, size=size).in_order()
        }
        assert lengths == {7}
