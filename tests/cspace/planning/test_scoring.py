"""How sure a model is of ways, beside what is true."""

import numpy as np
import pytest

from cspace.planning.cost import calibration_error


def test_the_calibration_error_is_the_distance_of_confidence_and_truth():
    sure = np.array([0.05, 0.05, 0.95, 0.95])
    assert calibration_error(sure, np.array([False, False, True, True])) == pytest.approx(0.05)
    assert calibration_error(sure, np.array([True, True, False, False])) == pytest.approx(0.95)
