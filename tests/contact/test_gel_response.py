"""From forces to the gel_loads of the gel: linear where the law is, with memory where not."""

import math
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from tacgen.contact.gel_response import gel_loads
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.records import ContactFrame, Estimate


def frames(forces_n, times_s, shear_n=(0.0, 0.0), torsion_n_mm=0.0):
    return tuple(
        ContactFrame(t, f, np.array(shear_n), torsion_n_mm, np.eye(4))
        for t, f in zip(times_s, forces_n, strict=True)
    )


def with_creep(amount, tau_s):
    parameters = {
        "amount": Estimate(amount),
        "tau_s": Estimate(tau_s),
        "recovery": Estimate(1.0),
    }
    creep = FittedEffect("creep", "normal", MappingProxyType(parameters))
    return replace(ContactLaw.linear(5.0), effects=(creep,))


def test_a_linear_law_is_linear_in_force_shear_and_torsion():
    law = ContactLaw.linear(5.0, 0.8)
    loads = gel_loads(law, frames([0, 2, 4], [0, 1, 2], (0.3, -0.5), 10.0))
    assert [load.volume_mm3 for load in loads] == pytest.approx([0, 10, 20])
    np.testing.assert_allclose([load.shear_sum_mm for load in loads], np.tile([0.24, -0.4], (3, 1)))
    np.testing.assert_allclose([load.turn_sum_mm2 for load in loads], 8.0)
    assert [load.indentation_mm for load in loads] == [None] * 3


def test_tactos_law_gives_a_depth_and_no_volume():
    law = replace(
        ContactLaw.linear(5.0), law="linear_depth", k_depth_mm_per_n=Estimate(0.02, 0.0, "mm/N")
    )
    loads = gel_loads(law, frames([2, 4], [0, 1]))
    assert [load.volume_mm3 for load in loads] == [None, None]
    assert [load.indentation_mm for load in loads] == pytest.approx([0.04, 0.08])
    kept = replace(law, collision_margin_mm=0.07)
    loads = gel_loads(kept, frames([2, 4], [0, 1]), k_n_factor=1.5)
    assert [load.indentation_mm for load in loads] == pytest.approx([0.0, 0.02 * 4 * 1.5 - 0.07])


def test_creep_shows_in_the_sequence_and_ends_at_its_asymptote():
    """A held force: the gel goes on yielding, to 1 + amount times the elastic imprint."""
    times = np.array([0.0, 0.1, 0.5, 1.0, 2.0, 20.0])
    loads = gel_loads(with_creep(0.3, 0.8), frames([0, 4, 4, 4, 4, 4], times))
    volume = np.array([load.volume_mm3 for load in loads])
    assert volume[0] == 0
    assert (np.diff(volume[1:]) > 0).all()
    assert volume[-1] == pytest.approx(5.0 * 4 * 1.3, rel=1e-6)
    # From 0.5 s to 1 s what is left of the creep falls by exp(-0.5/0.8).
    left = volume[-1] - volume
    assert left[3] / left[2] == pytest.approx(math.exp(-0.5 / 0.8), rel=1e-6)


def test_a_single_frame_knows_how_long_the_load_has_been_on():
    """As the last frame of a sequence does: a ramp over 0.1 s, then a hold."""
    sequence = frames([0, 4, 4], [0.0, 0.1, 3.0])
    past = np.array([[one.time_s, one.force_normal_n, 0.0, 0.0] for one in sequence])
    law = with_creep(0.3, 0.8)
    whole = [load.volume_mm3 for load in gel_loads(law, sequence)]
    for k in (1, 2):
        (alone,) = gel_loads(law, [replace(sequence[k], past=past[:k])])
        assert alone.volume_mm3 == pytest.approx(whole[k], rel=1e-12)
    # Nothing is known of its past: the load has just come, whatever the clock shows.
    for time_s in (0.1, 100.0):
        (sudden,) = gel_loads(law, frames([4], [time_s]))
        assert sudden.volume_mm3 == pytest.approx(20.0, rel=1e-3)


def test_a_gel_is_conditioned_by_the_first_grasps_of_a_dataset():
    parameters = {"amount": Estimate(0.5), "trials": Estimate(2.0)}
    effect = FittedEffect("conditioning", "normal", MappingProxyType(parameters))
    law = replace(ContactLaw.linear(5.0), effects=(effect,))
    volume = [
        gel_loads(law, frames([4], [1.0]), grasp_index=index)[0].volume_mm3 for index in (0, 1, 100)
    ]
    # Gain 1 + 0.5 exp(−n / 2), n the grasps before this one.
    expected = [20 * (1 + 0.5 * math.exp(-n / 2)) for n in (0, 1, 100)]
    assert volume == pytest.approx(expected, rel=1e-9)
