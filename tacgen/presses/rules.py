"""Every threshold of reading press logs and press images, with its reason, in two records."""

from dataclasses import dataclass

from tacgen.core.types import GELS_K_N_MM3_PER_N


@dataclass(frozen=True, slots=True, kw_only=True)
class LogRules:
    """Thresholds of reading a press log; a *share* is of a press's samples unless it says so."""

    # How large a table may be
    max_bytes: int = 256 << 20
    max_cells: int = 6_000_000  # a cell takes 140 bytes as it is read
    # How its cells are understood
    probed_rows: int = 200  # that tell the delimiter
    probed_cells: int = 2000  # of a column, that tell the marks in its numbers
    least_whole_share: float = 0.05  # of a column's numbers, below 1000 and without a mark: there
    # a mark parts thousands
    least_labelled: int = 4  # rows of a press that has a name: fewer are a slip of the pen
    most_summary_rows: int = 20  # below the samples
    gap_factor: float = 25.0  # times the median step of the clock: a gap
    most_blocks_share: float = 0.1  # of all rows: with more blocks, they are no presses
    # How much is spelled out
    max_listed: int = 5  # bad cells of one column, in an error
    max_warned: int = 5  # presses whose empty cells or gaps are warned of one by one

    # Cells and readings without a value
    max_empty_share: float = 0.5  # with more, the press is dropped; what is measured beside fewer
    # empty cells is as good as ever
    max_dropped_share: float = 0.5  # of all samples: with more gone, the rest is not the session
    usual_share: float = 0.99  # of the readings; those
    spike_factor: float = 30.0  # times beyond what so many are within are no readings

    # Clocks
    most_tied_share: float = 0.1  # at the time of the one before: with more, the clock is coarse
    shuffled_share: float = 0.1  # of all steps that go backwards: two presses under one number, few
    shortest_press_s: float = 0.01  # a press is no blink
    longest_press_s: float = 1e5  # and no day long
    latest_clock_s: float = 1e10  # 300 years after 1970
    usual_press_s: float = 5.0  # whose nearest unit is proposed
    odd_press_s: float = 300.0  # a longer press
    odd_step_s: float = 1.0  # with samples as rare as this may be in ms

    # Units and signs of force, volume and depth
    max_plausible_force_n: float = 100.0  # a gripper presses with less: the WSG-50 ends at 80 N
    read_k_n_mm3_per_n: tuple[float, float] = (0.5 * GELS_K_N_MM3_PER_N[0], GELS_K_N_MM3_PER_N[1])
    # what is read: laboratories press harder samples too, of 0.19 mm³/N
    doubtful_k_n_mm3_per_n: tuple[float, float] = (0.5, 30.0)  # beyond, another unit is as likely
    # as another gel: kgf for newtons makes 50 mm³/N of 5
    plausible_depths_mm: tuple[float, float] = (0.02, 50.0)  # of the deepest press: gels are 2 to
    # 10 mm thick, and seen to give way from 0.02 mm
    position_share: float = 0.8  # of the largest depth: where all are above it,
    position_mm: float = 5.0  # and it above this, they are counted from elsewhere than the gel
    least_approach_rows: int = 5  # before contact, in which depth grows and the force does not
    approach_sigmas: float = 5.0  # of the force's noise, that it stays within there
    onset_share: float = 0.3  # of the peak force, below which a power of the depth holds
    least_approach_share: float = 0.1  # of what is pressed: a zero that is off by less is a fit's
    sign_correlation: float = 0.5  # of force and size of the response: below its negative, the
    # sign is wrong
    rest_share: float = 0.05  # those with the least force: at rest
    held_share: float = 0.7  # of the peak: above it, the least force is of a hold
    rest_volume_share: float = 0.1  # of the largest volume or depth: one that falls by less with
    # the force is held, and one that is never less is not at rest
    outlier_factor: float = 8.0  # times softer or stiffer than the median press: another unit; kgf
    # for newtons are 9.8 times less

    # Rows that are independent readings
    least_runs: int = 20  # of readings that a judgement needs
    standing_share: float = 0.5  # of readings, between clear changes, that stand in two rows
    clear_steps: float = 4.0  # of a column's resolution: a smaller change is often none by chance
    moving_share: float = 0.3  # of the other column's course that goes on while a reading stands

    # Printed dots
    jump_pitches: float = 0.5  # off its neighbours' motion: another dot
    same_place_pitches: float = 0.25  # two dots so near each other's places are swapped
    grid_rounds: int = 8  # of turning and shifting the grid onto the dots


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageRules:
    """Thresholds of reading press images; *radii* are of the contact's circle."""

    # What ball radii and widths of a picture can be: others are in another unit
    balls_mm: tuple[float, float] = (0.1, 200.0)
    widths_mm: tuple[float, float] = (1.0, 150.0)

    # Sets of other toolkits
    max_about_bytes: int = 1 << 20  # of a file with a few numbers
    background_pictures: int = 101  # whose median stands in for a background: more change no level
    derived_off_share: float = 0.2  # of the circle that is seen, by which one derived from a depth
    # may be off: on pressed balls the seen one is 3 to 6 % wide and its centre within 2 %

    # The contact's circle
    work_width_px: int = 160  # images are looked at this wide: a circle needs no more
    dark_grey: float = 25.0  # change is against the light at its place, plus this much: in dark
    # corners too, a grey level of noise is no contact
    clear_sigmas: float = 5.5  # of the picture's scatter that a contact stands out by: noise alone
    # reaches 3.5, a contact whose surroundings fill half of the picture 6.5
    min_change_grey: float = 6.0  # and by this much: a still camera makes no press of dust
    patch_share: float = 0.2  # of the most changed pixels' change: the patch changed by as much
    edge_share: float = 0.5  # of a direction's largest change, at its edge: lamps make some sides
    # of a ball brighter, none wider
    rim_share: float = 0.9  # of the largest mean of all directions, where the contact ends: the gel
    # is steepest at the rim and falls off beyond it
    drift_degree: int = 3  # of lamps' drift in place: 2 leaves corners bright, 4 follows contacts
    drift_steps: int = 6  # of reweighting: a contact of a third of the image then moves it no more
    shaded_radii: float = 1.3  # how far out shading is fitted
    shaded_pixels: int = 400  # and on how many pixels
    shaded_ball_radii: float = 1.3  # the ball, and
    shaded_rim_radii: float = 0.4  # the decay of the slope beside it: what is off in them goes into
    # the polynomial of the shading
    shaded_start_edges: float = 0.65  # the contact that is tried first, in edge radii
    n_directions: int = 96  # every 3.75 degrees: some pixels apart at the rim
    profile_step_px: float = 0.25  # finer than the image resolves
    min_edge_directions: float = 0.4  # share of the directions in which an edge must be seen
    max_out_of_round_radii: float = 0.15  # median distance of the edge from the circle
    second_contact_share: float = 0.4  # of the largest patch's area: another is a contact from here
    second_strength_share: float = 0.5  # of the largest change: fainter are corners as lamps drift

    # Whether a press can be used
    min_presses: int = 3  # fewer cannot separate light from place
    max_outside_share: float = 0.25  # of a contact, out of view: more is warned of
    max_saturated_share: float = 0.9  # of a contact's pixels at 0 or 255 where the gel is not
    max_clipped_share: float = 0.5  # of a labelled circle at the camera's limit: a part is seen
    max_label_balls: float = 1.5  # radii of the ball, for a labelled circle: people circle the
    # gel's rim too
    max_label_off_radii: float = 0.75  # from the circle that is seen: it is of something else
    own_change_share: float = 0.9  # of the seen circle's change: a labelled one is a contact anyway
    least_change_grey: float = 2.0  # in a labelled circle where no contact is seen anywhere

    # Whether the background is of this gel at rest; measured sets: seven, of four sensors
    compared_width_px: int = 80  # light and crop show at any size
    other_picture: tuple[float, float] = (2.0, 1.5)  # times the lower quartile of all pictures'
    # difference, and so many grey levels more, is looked at: within five sets below 1.5 times,
    # between any two of them above 2.5
    other_background: tuple[float, float] = (1.6, 1.0)  # the same of the median of the presses
    # against what single ones differ from it by
    unexplained_share: float = 0.5  # of the bare gel's variation of light: another gel, sensor or
    # crop leaves as much; within a set at most 0.3 is left, between two sensors 0.3 to 2.5
    background_min_presses: int = 5  # a median of fewer pictures shows the contacts themselves
    moved_share: float = 0.4  # of presses that lie elsewhere: a background with a contact is one
    press_strength_share: float = 0.3  # of the change of theirs that its contact makes: 0.04 for
    # presses that overlap, 0.45 to 3 for a press (rig and three real sensors)
    min_alike: int = 3  # presses that prove it, where they show the gel there alike,
    alike_share: float = 0.1  # off their median by less of the squares that the background is off,
    own_strength_share: float = 0.5  # and each differs by so much of it by a contact of its own,
    beyond_place_radii: float = 1.5  # at another place: overlapping presses differ at one only

    # Which pictures are of one press
    near_px: float = 1.0  # circles, or stage places and radii: labels are set to whole pixels
    alike_press_share: float = 0.1  # of what either differs from the gel at rest by: a contact of
    # 40 px moved by 2 px reaches it, noise of 1 grey level under a light touch half of it
    rows_at_once: int = 1000  # of the matrix of pictures against pictures
    compared_press_px: int = 40  # most columns that are compared, each a mean over at least
    block_px: int = 8  # pixels, which leaves little of a camera's noise
    pause_s: float = 0.3  # without contact, after which a recording's next press begins: a hand or
    # a stage takes longer to come back, a touch too light to be seen does not last so long


LOG = LogRules()
IMAGES = ImageRules()
