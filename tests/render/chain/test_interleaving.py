"""Raw frames of a mosaic by hand: two channels in a chequer, one of them in no band."""

import numpy as np
from cboxlab.rendering.chain.interleaving import Interleaving, UnseenChannel

RED = np.indices((4, 6)).sum(axis=0) % 2 == 0
#: The pixels of the other channel show the red light times 0.5.
ONE_BAND = Interleaving(RED[None], ((0,),), (UnseenChannel(0, ~RED, 0.5),))


def test_an_unseen_channel_shows_a_bands_light_times_its_factor():
    signal = np.arange(24.0).reshape(1, 4, 6)
    np.testing.assert_array_equal(ONE_BAND.light(signal)[0], np.where(RED, signal[0], 0.5 * signal[0]))


def test_a_response_is_relative_to_the_mean_of_each_channel():
    ripple = 1 + 0.1 * np.arange(24.0).reshape(4, 6)
    response = np.where(RED, ripple / ripple[RED].mean(), 2 * ripple)[None]
    frame = ONE_BAND.response(response)[0]
    np.testing.assert_allclose([frame[RED].mean(), frame[~RED].mean()], 1.0)
    np.testing.assert_allclose(frame[~RED], ripple[~RED] / ripple[~RED].mean())


def test_bands_of_one_frame_share_it():
    both = Interleaving(np.stack([RED, ~RED]), ((0, 1),))
    frames = both.light(np.stack([np.full(RED.shape, 3.0), np.full(RED.shape, 7.0)]))
    np.testing.assert_array_equal(frames[0], np.where(RED, 3.0, 7.0))
    np.testing.assert_array_equal(frames[1], frames[0])
