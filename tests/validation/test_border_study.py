"""What the study of adaptive grids reads off its curves."""

import numpy as np
import pytest

pytest.importorskip("sklearn")

from validation.collection.border import COUNTS, share_needed


def test_the_share_of_grasps_is_read_between_the_counts():
    """Errors that fall with n at random and twice as fast near the border: half are needed."""
    counts = np.array(COUNTS)
    random = counts / 1000
    assert share_needed(random, 2 * random, 170) == pytest.approx(0.5)
    assert share_needed(random, random, 170) == pytest.approx(1.0)
    assert np.isnan(share_needed(random, random / 2, 310))
    # Reached from the start: no fewer than the grasps that both have in common.
    assert share_needed(random, random + 1, 310) == COUNTS[0] / 310
