"""The shear of a gel against closed forms: stick and slip, memory, and how far it reaches."""

import math

import numpy as np
import pytest
from scipy.special import k1

from tacgen.contact.shear_field import ShearField

MU, P_N, RADIUS_MM = 0.6, 5.0, 3.0
CENTER = np.zeros(2)
FOUNDATION = 1e-6  # mm: a decay of which neighbours know nothing of each other


def ball(field, at_mm=(0.0, 0.0), radius_mm=RADIUS_MM, force_n=P_N):
    """The pressure of a ball on a foundation, 2P/πa² (1 − r²/a²), averaged over each cell."""
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    shape = np.zeros(field.shape)
    for dx in fine:
        for dy in fine:
            away = field.nodes_mm + np.array([dx, dy]) * field.lattice_mm - at_mm
            shape += np.maximum(0.0, 1.0 - (away**2).sum(axis=-1) / radius_mm**2)
    return shape * force_n / (shape.sum() * field.lattice_mm**2)


@pytest.fixture(scope="module")
def foundation():
    return ShearField(8.0, 8.0, FOUNDATION, 0.1)


def pulled(field, force_n, before=None, torsion_n_mm=0.0, pressure=None, friction=MU):
    """A pull along x; a turn about the middle."""
    pressure = ball(field) if pressure is None else pressure
    return field.step(pressure, np.array([force_n, 0.0]), torsion_n_mm, CENTER, friction, before)


def slide_of(share):
    """How far the ball has moved, over c, when it pulls with a share of μP: Winkler's foundation.

    Where the gel sticks t = s; at its border, r = b, s = μ p(b), and Q/μP = 1 − (b/a)⁴.
    """
    peak = 2 * P_N / (math.pi * RADIUS_MM**2)
    return MU * peak * (1 - math.sqrt(1 - share))


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.95])
def test_the_stick_region_of_a_ball_on_a_foundation(foundation, share):
    """Cattaneo and Mindlin's (1 − Q/μP)^(1/3) is of a half-space; of a foundation it is 1/4."""
    state = pulled(foundation, share * MU * P_N)
    stick_mm = math.sqrt(state.sticks.sum() * foundation.lattice_mm**2 / math.pi)
    assert stick_mm / RADIUS_MM == pytest.approx((1 - share) ** 0.25, rel=0.02)
    assert state.slide[0] == pytest.approx(slide_of(share), rel=0.01)


def test_a_cycle_is_the_loop_of_the_closed_form(foundation):
    """Masing: back from Q_m the ball has moved s(Q_m) − 2 s((Q_m − Q) / 2)."""
    most, limit_n = 0.9, MU * P_N
    state = pulled(foundation, most * limit_n)
    place = state.slide[0]
    assert place == pytest.approx(slide_of(most), rel=0.01)
    for share in (0.5, 0.0, -0.5, -0.9):
        state = pulled(foundation, share * limit_n, state)
        place += state.slide[0]
        assert place == pytest.approx(
            slide_of(most) - 2 * slide_of((most - share) / 2), abs=0.01 * slide_of(most)
        )
    for share in (-0.5, 0.0, 0.5, 0.9):
        state = pulled(foundation, share * limit_n, state)
        place += state.slide[0]
    assert place == pytest.approx(slide_of(most), rel=0.01)


@pytest.mark.parametrize("stick", [0.9, 0.7, 0.5])
def test_a_turn_slips_from_the_rim(foundation, stick):
    """Of a foundation: t = θ r up to b, where it is μ p(b)."""
    a, b, peak = RADIUS_MM, stick * RADIUS_MM, 2 * P_N / (math.pi * RADIUS_MM**2)
    turn = MU * peak * (1 - stick**2) / b
    slips = MU * peak * ((a**3 - b**3) / 3 - (a**5 - b**5) / (5 * a**2))
    state = pulled(foundation, 0.0, None, 2 * math.pi * (turn * b**4 / 4 + slips))
    assert state.slide[2] == pytest.approx(turn, rel=0.02)
    found_mm = math.sqrt(state.sticks.sum() * foundation.lattice_mm**2 / math.pi)
    assert found_mm == pytest.approx(b, rel=0.02)


def test_a_ball_that_rolls_creeps(foundation):
    """Without slip, t grows from the front edge on: F = (ξ/c) 8a³/3 for a creepage ξ."""
    field, force_n, step_mm, state = ShearField(8.0, 24.0, FOUNDATION, 0.15), 0.4, 0.15, None
    frames = np.zeros(field.shape)  # since each cell was touched
    for k in range(75):  # 11 mm: the contact has left where it was after 6
        center = np.array([0.0, -5.5 + step_mm * k])
        pressure = ball(field, center)
        state = field.step(pressure, np.array([0.0, force_n]), 0.0, center, 50.0, state)
        frames = np.where(pressure > 0, frames + 1, 0)
    creepage = state.slide[1] / step_mm
    held_mm3 = (frames * step_mm).sum() * field.lattice_mm**2
    assert creepage == pytest.approx(force_n / held_mm3, rel=0.02)
    # Cells that are touched in part count whole: half a cell of the radius, whose cube it is.
    assert creepage == pytest.approx(3 * force_n / (8 * RADIUS_MM**3), rel=0.1)


def test_what_sticks_loses_no_energy_and_what_slips_never_gains_any():
    field, rng = ShearField(14.0, 12.0, 1.5), np.random.default_rng(5)
    pressure = ball(field, force_n=8.0)
    path = np.concatenate([np.cumsum(rng.normal(0, 0.7, (20, 3)), axis=0), np.zeros((1, 3))])
    path *= min(1.0, 0.9 * MU * 8.0 / np.hypot(*path[:, :2].T).max())
    for friction in (1e6, MU):
        state, load, work, least = None, np.zeros(3), 0.0, 0.0
        for force in path:
            state = field.step(pressure, force[:2], force[2], CENTER, friction, state)
            work += 0.5 * (load + force) @ state.slide
            load = force
            least = min(least, work)
        stored = 0.5 * (np.abs(path).max(axis=0) ** 2).sum()
        if friction > 1:
            # Solved to 1e-5 of the motion of each of 21 frames.
            assert abs(work) < 1e-3 * stored
            assert np.abs(state.sheet).max() < 1e-3 * np.abs(path).max()
        else:
            assert work > 0.02 * stored
        assert least > -1e-3 * stored


def test_the_gel_turns_around_a_stuck_disc_as_bessels_function_says():
    """A turn has no divergence: w_θ − ℓ² (w_θ'' + w_θ'/r − w_θ/r²) = 0 beside it, K₁(r/ℓ)."""
    decay_mm = 1.5
    field = ShearField(24.0, 24.0, decay_mm, 0.2)
    state = field.step(ball(field, radius_mm=2.0), np.zeros(2), 3.0, CENTER, 1e6)
    at_mm = np.array([3.0, 4.0, 5.0, 6.0])
    for turn in (0.0, 0.7, 1.9):
        points = np.stack([at_mm * math.cos(turn), at_mm * math.sin(turn)], axis=1)
        moved = field.motion_mm(state, points, 1.0)
        around = moved @ [-math.sin(turn), math.cos(turn)]
        np.testing.assert_allclose(
            around / around[0], k1(at_mm / decay_mm) / k1(3.0 / decay_mm), rtol=0.03
        )
        # The lattice's disc has steps of a tenth of its radius.
        assert np.abs(moved @ [math.cos(turn), math.sin(turn)]).max() < 0.04 * around[0]


@pytest.mark.parametrize(("along", "reach"), [(0, math.sqrt(5.0)), (1, 1.0)])
def test_a_push_reaches_farther_ahead_than_aside(along, reach):
    """Beside a long strip the motion falls off by e in √5 ℓ, or in ℓ: a bonded thin layer's.

    Of an incompressible layer of thickness h, c(k) is 1 − 5/3 (kh)² + … for a push along k and
    1 − 1/3 (kh)² + … across it.
    """
    field = ShearField(30.0, 60.0, 1.0, 0.3)
    pressure = np.where(np.abs(field.nodes_mm[..., 0]) < 0.4, 1.0, 0.0)
    force_n = np.zeros(2)
    force_n[along] = 4.0
    state = field.step(pressure, force_n, 0.0, CENTER, 1e6)
    points = np.stack([np.array([2.0, 4.0, 6.0]), np.zeros(3)], axis=1)
    moved = field.motion_mm(state, points, 1.0)[:, along]
    np.testing.assert_allclose(np.diff(np.log(moved)), -2.0 / reach, rtol=0.02)


@pytest.mark.parametrize("share", [0.3, 0.9, 1.5])
def test_tractions_sum_to_the_force_and_points_to_ds_law(share):
    """∫ u dA = c F, on a window so wide that none of it is beyond; 0.98 of it in gross slip."""
    field, force_n = ShearField(40.0, 36.0, 1.5), share * MU * 8.0 * np.array([0.6, -0.8])
    pressure = ball(field, force_n=8.0)
    state = field.step(pressure, force_n, 1.0, CENTER, MU)
    cell_mm2 = field.lattice_mm**2
    np.testing.assert_allclose(state.traction.sum(axis=(0, 1)) * cell_mm2, force_n, rtol=1e-9)
    held = np.linalg.norm(state.held, axis=-1)
    assert (held <= MU * pressure + 1e-6).all()
    points = field.nodes_mm.reshape(-1, 2)
    summed = field.motion_mm(state, points, 2.5).sum(axis=0) * cell_mm2
    np.testing.assert_allclose(summed, 2.5 * min(1.0, 0.98 / share) * force_n, rtol=0.02)
