"""Readers of other packages: used by their endings, refused in one line where they do not keep the contract."""

import sys

import numpy as np
import pytest
from cboxlab.calibration import frame_readers
from cboxlab.calibration.frame_readers import FrameFacts, FrameHeader, FrameReader, read_pictures
from cboxlab.utils import other_packages
from cboxlab.utils.errors import InputError

SHAPE = (12, 16)
CUBE = np.random.default_rng(1).integers(0, 65535, (3, *SHAPE)).astype(np.uint16)


class Entry:
    """An entry point of another package."""

    name, value = "mine", "mine:READER"

    def __init__(self, loaded):
        self.loaded = loaded

    def load(self):
        return self.loaded


def mine(**changes):
    fields = {
        "id": "mine",
        "name": "mine",
        "suffixes": (".mine",),
        "needs": None,
        "header": lambda path: FrameHeader(SHAPE, 3, FrameFacts(exposure_s=2.0)),
        "read": lambda path, pictures: CUBE[list(pictures)],
    }
    return FrameReader(**{**fields, **changes})


@pytest.fixture
def plugged(monkeypatch):
    def plug(reader):
        monkeypatch.setattr(other_packages, "entry_points", lambda group: [Entry(reader)])
        frame_readers.frame_reader_catalogue.cache_clear()

    yield plug
    frame_readers.frame_reader_catalogue.cache_clear()


def test_a_reader_of_another_package(tmp_path, plugged):
    plugged(mine())
    (tmp_path / "a.mine").touch()
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.mine"), CUBE)
    np.testing.assert_array_equal(read_pictures(tmp_path / "a.mine", range(2, 3)), CUBE[2:])
    assert ".mine" in frame_readers.suffixes()


@pytest.mark.parametrize(
    ("reader", "phrases"),
    [(7, "a int"), (mine(id="fits"), "'fits', which is there"), (mine(suffixes=(".tif",)), "ending .tif")],
    ids=["no reader", "identifier", "ending"],
)
def test_a_reader_that_does_not_fit_is_refused(plugged, reader, phrases):
    plugged(reader)
    with pytest.raises(InputError, match=f"cboxlab.frames.*{phrases}"):
        frame_readers.frame_reader_catalogue()


def test_a_reader_whose_pictures_do_not_fit_its_header(tmp_path, plugged):
    plugged(mine(read=lambda path, pictures: CUBE[:1]))
    (tmp_path / "a.mine").touch()
    with pytest.raises(InputError, match="as in the file's header"):
        read_pictures(tmp_path / "a.mine")


#: What a reader of another package does, and words of the message.
MISBEHAVIOUR = {
    "its header raises": ({"header": lambda path: 1 / 0}, "ZeroDivisionError"),
    "its header ends the program": ({"header": lambda path: sys.exit(3)}, "an attempt to end the program"),
    "its header is nothing": ({"header": lambda path: None}, "a NoneType"),
    "its pictures are negative": ({"header": lambda path: FrameHeader(SHAPE, -3)}, "-3 pictures"),
    "its size is text": ({"header": lambda path: FrameHeader(("4", "5"), 3)}, "whole numbers"),
    "it ends the program": ({"read": lambda path, pictures: sys.exit()}, "an attempt to end the program"),
    "it raises what is no Exception": ({"read": lambda path, pictures: exec("raise GeneratorExit")}, "GeneratorExit"),
    "it gives nothing": ({"read": lambda path, pictures: None}, "a NoneType"),
    "it gives a list": ({"read": lambda path, pictures: CUBE.tolist()}, "a list"),
    "it gives fractions": ({"read": lambda path, pictures: CUBE / np.nan}, "float64 numbers"),
}


@pytest.mark.parametrize("way", MISBEHAVIOUR)
def test_a_reader_that_misbehaves_is_named_in_one_line(tmp_path, plugged, way):
    fields, phrase = MISBEHAVIOUR[way]
    plugged(mine(**fields))
    (tmp_path / "a.mine").touch()
    with pytest.raises(InputError) as refusal:
        read_pictures(tmp_path / "a.mine")
    message = str(refusal.value)
    assert "cboxlab.frames: mine = mine:READER" in message and phrase in message and "a.mine" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "fields", [{"id": 7}, {"suffixes": ()}, {"suffixes": "mine"}, {"read": None}, {"needs": 3}, {"name": None}]
)
def test_a_reader_with_a_wrong_field_is_refused(plugged, fields):
    plugged(mine(**fields))
    with pytest.raises(InputError, match=rf"cboxlab\.frames.*wrong .*{next(iter(fields))}"):
        frame_readers.frame_reader_catalogue()
