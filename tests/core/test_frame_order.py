"""Pictures named by number or time: one order, that of the numbers, or a refusal."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacgen.core.errors import TacgenError
from tacgen.core.images import in_time_order
from tests.messages import refused


def order_of(names):
    return [path.name for path in in_time_order([Path("grasp", name) for name in names])]


@given(
    st.lists(st.integers(0, 100_000), min_size=1, max_size=30, unique=True),
    st.sampled_from(["{}.png", "frame{}.png", "img_{:03d}.jpg", "cam1_{}_left.png"]),
)
def test_whole_numbers_come_in_their_order(numbers, form):
    assert order_of([form.format(n) for n in numbers]) == [form.format(n) for n in sorted(numbers)]


@given(st.integers(0, 2**32 - 1))
def test_seconds_of_a_clock_come_in_their_order_with_any_number_of_decimals(seed):
    rng = np.random.default_rng(seed)
    times = np.unique(np.round(1.76e9 + rng.uniform(0, 2, 20), 4))
    names = [f"{time}.png" for time in times.tolist()]  # str() drops zeros at the end
    assert order_of(rng.permutation(names).tolist()) == names


def test_a_frame_and_a_second_count_in_this_order():
    names = ["g_2_161.jpg", "g_10_162.jpg", "g_1_161.jpg"]
    assert order_of(names) == ["g_1_161.jpg", "g_2_161.jpg", "g_10_162.jpg"]


@pytest.mark.parametrize(
    "names",
    [
        ["before.png", "during.png", "after.png"],
        ["0.png", "1.png", "2_.png"],
        ["a1.png", "b2.png"],
        ["1.png", "01.png"],
        ["1.png", "1.jpg"],
        ["cam1.9.png", "cam1.10.png"],
    ],
)
def test_names_without_one_order_are_refused(names):
    with refused(TacgenError):
        order_of(names)
