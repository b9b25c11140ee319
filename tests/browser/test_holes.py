"""What counts as a hole between two pictures: background where geometry is closed, not a gap that an edge moved along."""

import numpy as np
from pictures import holes_of


def test_background_where_the_truth_is_closed_is_a_hole():
    truth, shown = np.zeros((8, 8)), np.zeros((8, 8))
    shown[3, 4] = 0.25  # one of four samples
    assert np.argwhere(holes_of(shown, truth)).tolist() == [[3, 4]]
    truth[:, 6] = 1.0  # open two pixels away: closed around here
    assert holes_of(shown, truth).sum() == 1


def test_a_gap_between_two_houses_may_be_wider_by_the_pixel_error_but_not_by_more():
    truth = np.zeros((8, 8))
    truth[:, 4] = 0.5
    shown = truth.copy()
    shown[:, 4] = 0.75
    assert not holes_of(shown, truth).any()
    shown[:, 3] = shown[:, 5] = 1.0
    assert not holes_of(shown, truth).any()
    shown[2, 6] = 0.25
    assert np.argwhere(holes_of(shown, truth)).tolist() == [[2, 6]]
