"""Signal whose noise counts where the model lacks light."""

from types import SimpleNamespace

import numpy as np
from cboxlab.validation.compare.prepared import CalibratedCapture


def test_noise_is_the_photographs_where_it_is_twice_the_model():
    """Not for samples below a twentieth of the median, nor for masked ones."""
    usable = np.array([[[True, True, True, True, False, True, True]]])
    measured = np.array([[[100.0, 100, 100, 2, 900, 120, 80]]])
    model = np.array([[[49.0, 51, 0, 0.1, 1, 130, 70]]])
    capture = SimpleNamespace(usable=usable, measured=measured)
    signal = CalibratedCapture.noise_reference_signal(capture, model)
    np.testing.assert_array_equal(signal, [[[100.0, 51, 100, 0.1, 1, 130, 70]]])
