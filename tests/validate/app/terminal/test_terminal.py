"""The terminal: honest times, loudness, JSON apart from text, help that keeps square brackets, suggestions."""

import json

import pytest
from cboxlab.validation.app.commands.app import app
from cboxlab.validation.app.commands.arguments import complete_effect
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.terminal import (
    command_line,
    console,
    data_table,
    give_json,
    print_table,
    time_text,
)
from cboxlab.validation.app.terminal.stages import Stages


class Clock:
    """Seconds that pass only on command."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def followed(reports, title="starting"):
    """Stages and the lines they printed, after reports (seconds since the start, stage, share done)."""
    clock, lines = Clock(), []
    stages = Stages(title, lines.append, clock)
    for seconds, stage, done in reports:
        clock.now = 100.0 + seconds
        stages.report(stage, done)
    return stages, lines


def test_a_stage_that_is_over_is_a_line_with_its_time():
    stages, lines = followed([(0, "calibrating", 0), (3, "rendering", 0.1), (63.4, "comparing", 0.9)])
    assert lines == ["calibrating: 3.0 s", "rendering: 1 min 00 s"]
    assert stages.stage == "comparing"


def test_time_left_follows_from_time_gone_and_share_done():
    stages, _ = followed([(0, "rendering", 0.0), (30, "rendering", 0.25)])
    assert stages.remaining_s() == pytest.approx(90)
    assert stages.times() == "30 s elapsed, about 1 min 30 s left"


def test_time_left_grows_when_more_work_turns_up():
    reports = [(0, "rendering", 0.0), (30, "rendering", 0.5), (30, "rendering", 0.25)]
    assert followed(reports)[0].remaining_s() == pytest.approx(90)


@pytest.mark.parametrize("report", [(60, "rendering", 0.01), (1, "rendering", 0.5), (60, "fitting", 1.0)])
def test_no_time_left_is_stated_where_it_would_be_a_guess(report):
    stages, _ = followed([report])
    assert stages.remaining_s() is None and "left" not in stages.times()


def test_a_long_stage_is_reported_while_it_lasts():
    _, lines = followed([(0, "rendering", 0.0), (20, "rendering", 0.1), (40, "rendering", 0.2)])
    assert lines == ["rendering: 20% of the computation, 40 s elapsed, about 2 min 40 s left"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.42, "0.4 s"), (9.96, "10 s"), (59.6, "1 min 00 s"), (3601, "1 h 00 min"), (7380, "2 h 03 min")],
)
def test_times_as_people_say_them(seconds, text):
    assert time_text(seconds) == text


def test_help_keeps_what_stands_in_square_brackets(cbox):
    assert "a [[band]] per filter" in " ".join(cbox("hyperspectral", "--help")[1].split())


def test_help_of_the_program_cuts_no_sentence(cbox):
    code, out, _ = cbox("--help")
    assert code == 0 and "..." not in out.replace("[ARGS]...", "")


def test_every_command_can_be_quiet_and_verbose(cbox):
    for command in app.registered_commands:
        out = cbox(command.callback.__name__.rstrip("_"), "--help")[1]
        assert "--quiet" in out and "--verbose" in out


def test_commands_with_results_write_json(cbox):
    silent = {"demo", "export", "studio"}
    for command in app.registered_commands:
        name = command.callback.__name__.rstrip("_")
        assert name in silent or "--json" in cbox(name, "--help")[1], name


def test_the_version(cbox):
    from importlib.metadata import version

    assert cbox("--version") == (0, f"cbox {version('cboxlab')}\n", "")


def test_quiet_prints_nothing_but_errors(tmp_path, cbox):
    assert cbox("add", tmp_path / "m.toml", "ghost", "fraction=0.1", "--quiet") == (0, "", "")
    code, out, err = cbox("add", tmp_path / "m.toml", "gost", "--quiet")
    assert (code, out) == (2, "") and err.startswith("error: ")
    assert cbox("add", tmp_path / "m.toml", "ghost", "fraction=0.1")[1] != ""  # the next one is loud again


def test_json_on_standard_output_stands_alone(tmp_path, cbox):
    code, out, err = cbox("add", tmp_path / "m.toml", "ghost", "fraction=0.1", "--json", "-")
    assert code == 0 and json.loads(out)["added"] == {
        "effect": "ghost",
        "parameters": {"fraction": 0.1},
        "sigma": {},
    }
    assert "added ghost" in err
    assert "{" not in cbox("effects", "ghost")[1]


@pytest.mark.parametrize(
    ("option", "described"),
    [("--json", "a folder"), ("--picture", "a folder"), ("--json", "a file"), ("--picture", "a file")],
)
def test_results_that_cannot_be_written_are_refused_before_the_computation(option, described, cbox, tmp_path):
    """A folder in place of the file, and a file in place of its folder."""
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").touch()
    target = tmp_path / ("folder.png" if described == "a folder" else "file/result.png")
    code, _, err = cbox("effects", "veiling-glare", option, target)
    assert code == 2 and f"found {described}" in err


def test_json_of_a_comparison_is_that_of_its_folder(tmp_path, cbox):
    arguments = ("--out", tmp_path / "maps", "--json", tmp_path / "c.json")
    assert cbox("compare", DEMO_CAPTURE, DEMO_CAPTURE, *arguments)[0] == 0
    written = json.loads((tmp_path / "c.json").read_text())
    assert written == json.loads((tmp_path / "maps" / "comparison.json").read_text())


@pytest.mark.parametrize("width", [40, 80, 200])
@pytest.mark.parametrize("count", [1, 4, 16])
def test_numbers_of_a_table_are_never_cut(width, count, monkeypatch):
    """Sixteen bands in a terminal of 80 signs were columns of dots."""
    monkeypatch.setattr(console, "width", width)
    names = ["back", "a block, " * 9 + "the last"]
    bands, cells = [f"b{i}" for i in range(count)], [[f"{i}{row}.2345" for i in range(count)] for row in "17"]
    table = data_table("Bands", "surface", *bands)
    for name, row in zip(names, cells, strict=True):
        table.add_row(name, *row)
    with console.capture() as printed:
        print_table(table)
    lines = printed.get().splitlines()
    cells_printed = " ".join(lines).split()
    assert max(map(len, lines)) <= width
    assert sorted(word for word in cells_printed if word in bands) == sorted(bands)
    assert sorted(word for word in cells_printed if ".2345" in word) == sorted(cells[0] + cells[1])
    assert cells_printed.count("Bands") == 1 and cells_printed.count("back") == cells_printed.count(
        "surface"
    ) == cells_printed.count("last")
    assert cells_printed.count("back") == 1 or (width, count) in ((40, 16), (80, 16), (40, 4))


def test_numbers_that_are_not_finite_become_null(tmp_path):
    give_json(tmp_path / "a.json", {"a": [float("nan"), 1.0], "b": {"c": float("inf")}, "d": tmp_path})
    assert json.loads((tmp_path / "a.json").read_text()) == {
        "a": [None, 1.0],
        "b": {"c": None},
        "d": str(tmp_path),
    }


@pytest.mark.parametrize(
    ("arguments", "near"),
    [
        (["validat"], "validate"),
        (["validate", "x", "--modle", "y"], "--model"),
        (["effects", "glare"], "veiling-glare"),
        (["effects", "defocuss"], "defocus"),
        (["add", "m.toml", "ghost", "fracton=0.1"], "'fraction'"),
    ],
)
def test_a_mistyped_name_gets_a_suggestion(arguments, near, cbox, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = cbox(*arguments)
    assert code == 2 and near in err and not list(tmp_path.iterdir())


def test_the_catalogue_is_a_page(cbox):
    """One line for each effect, of at most 80 characters."""
    lines = cbox("effects")[1].splitlines()
    assert max(map(len, lines)) <= 80 and len(lines) <= 50


def test_effects_complete_in_the_shell():
    assert complete_effect("lamp-d") == ["lamp-directional", "lamp-drift"]


def test_options_of_all_commands_reach_none_of_them():
    """A command is called with its own arguments alone."""
    parsed = []

    def greet(name: str, *, loud: bool = False) -> None:
        """Greet."""
        parsed.append((name, loud))

    with pytest.raises(SystemExit):
        command_line("A program.", [greet])(args=["greet", "Ann", "--loud", "--verbose"])
    assert parsed == [("Ann", True)]
