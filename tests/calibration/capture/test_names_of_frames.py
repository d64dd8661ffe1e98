"""What the name of a frame says with certainty, and what it does not."""

import pytest
from cboxlab.calibration.capture.frame_names import common_words, kind_in_words, parse_name


@pytest.mark.parametrize(
    ("stem", "exposure"),
    [
        ("f650_0,25s", 0.25),
        ("f650-0.25s-1", 0.25),
        ("f550-4s", 4.0),
        ("f550-250ms-0", 0.25),
        ("f550_80us", 80e-6),
        ("f550 (2sec)", 2.0),
        ("20240512_550_4s", 4.0),
        ("2024-05-12_f550_4s", 4.0),
        ("2024-05-12T10-20-30_f550_1,5s", 1.5),
        ("F550-4S", 4.0),
        ("dark-0.5s-0", 0.5),
        ("f550 2 min", 120.0),
        ("dark 1,5min-0", 90.0),
        ("f550 0.5 s 3", 0.5),
        # a fraction, a decimal, or a repeat and whole seconds
        ("F450_1-30s", None),
        ("f550_1_4s", None),
        ("f550-1-4s", None),
        ("f550 0 25s", None),
        ("f550_12-30s", None),
        ("f550 2 min 30 s", None),
        ("f550_1-2 min", None),
        ("f550_2_min", None),
        ("IMG_0004 s", None),
        # no exposures
        ("f550_5min_after_on", None),
        ("f550_5m", None),
        ("exp250ms_f550", 0.25),
        ("filter550_exposure2s_001", 2.0),
        ("experiment2s_f550", None),
        ("f550-0s", None),
        ("f550_4sigma", None),
        ("f550-4s-2s", None),
        ("IMG_0004", None),
        ("f550-4", None),
        ("f550-s", None),
        ("f550-1.4.5s", None),
        ("f550-1,000,5s", None),
        # the seconds of all pictures of a sum
        ("Stack_32bits_550frames_2200s", None),
        ("f550_stacked_40s", None),
    ],
)
def test_exposures(stem, exposure):
    assert parse_name(stem).exposure_s == (None if exposure is None else pytest.approx(exposure))


@pytest.mark.parametrize(
    ("stem", "band"),
    [
        ("f550-4s-0", "f550"),
        ("550nm-4s", "f550"),
        ("F550", "f550"),
        ("box_f550nm", "f550"),
        ("band450-1s", "f450"),
        ("550-4s-0", "f550"),
        ("flat_550_1s", "f550"),
        ("20240512_550_4s", "f550"),
        ("2024-05-12_f550_4s", "f550"),
        ("20240512_102030_f1050", "f1050"),
        # numbers of cameras, dates and others
        ("IMG_0550", None),
        ("IMG_550", None),
        ("IMG_550_4s", None),
        ("DSC00550", None),
        ("_DSC0550", None),
        ("DSCF0550", None),
        ("P1010550", None),
        ("filter550_exp20ms_001", "f550"),
        ("KURIOS_WL550_BW10", "f550"),
        ("lambda550_wavelength550", "f550"),
        ("filter2_4s", None),
        ("100_0550", None),
        ("0550", None),
        ("550", None),
        ("2024", None),
        ("f2024", None),
        ("f8-4s", None),
        ("f0550", None),
        ("f550-f600", None),
        ("box-v550", None),
    ],
)
def test_filters(stem, band):
    assert parse_name(stem).filter == band


@pytest.mark.parametrize(
    ("stem", "kind", "other_words_expected"),
    [
        ("dark-4s-0", "dark", ()),
        ("Dark_4s_01", "dark", ()),
        ("dark01", "dark", ()),
        ("bias-0003", "dark", ()),
        ("dark_frame_4s", "dark", ()),
        ("flat-field-f550", "flat", ()),
        ("flat-open-0", "flat", ("open",)),
        ("integrating-sphere-f550", "reference", ()),
        ("sphere-f450-2s", "reference", ()),
        ("chessboard-0", "target", ()),
        # words that hold or follow a kind
        ("darkroom-box-f550-1s", None, ("darkroom", "box")),
        ("flatwhite-box-f600", None, ("flatwhite", "box")),
        ("hemisphere-f550", None, ("hemisphere",)),
        ("biased-f550", None, ("biased",)),
        ("box-flat-f550", None, ("box", "flat")),
        ("targeted", None, ("targeted",)),
        ("dark-flat-f550", None, ("dark", "flat")),
    ],
)
def test_kinds(stem, kind, other_words_expected):
    name = parse_name(stem)
    assert (name.kind, name.other_words) == (kind, other_words_expected)


@pytest.mark.parametrize(
    ("stem", "repeat", "series"),
    [
        ("f550-0", 0, "f550"),
        ("f550_4s_12", 12, "f550_4s"),
        ("open-1", 1, "open"),
        ("box (2)", 2, "box"),
        ("f550-0001", None, "f550-0001"),
        ("IMG_0550", None, "IMG_0550"),
        ("550", None, "550"),
        ("7", None, "7"),
        ("f550-4s", None, "f550-4s"),
        ("f550_1_4s", None, "f550_1_4s"),
    ],
)
def test_repeats(stem, repeat, series):
    name = parse_name(stem)
    assert (name.repeat, name.series) == (repeat, series)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("Light", "band"),
        ("LIGHT FRAME", "band"),
        ("object", "band"),
        ("Dark Frame", "dark"),
        ("BIAS", "dark"),
        ("zero", "dark"),
        ("Flat Field", "flat"),
        ("SKYFLAT", "flat"),
        ("", None),
        ("darkened", None),
        ("dark flat", None),
        ("tricolor image", None),
    ],
)
def test_kinds_of_headers(text, kind):
    assert kind_in_words(text) == kind


@pytest.mark.parametrize(
    ("stems", "count"),
    [
        (["cornell_dark_4s", "cornell_f550_4s"], 1),
        (["my-box-f550", "my-box-dark"], 2),
        (["f550-0", "f550-1"], 0),
        (["dark-1s", "dark-2s"], 0),
        (["box-f550"], 0),
        (["box", "box-1"], 1),
    ],
)
def test_words_that_all_names_share(stems, count):
    assert common_words(stems) == count


def test_the_name_of_a_project_comes_before_the_kind():
    assert parse_name("cornell_dark_4s_01", 1).kind == "dark"
    assert parse_name("cornell_f550_4s_01", 1).filter == "f550"
    assert parse_name("IMG_550_4s", 1).filter is None
