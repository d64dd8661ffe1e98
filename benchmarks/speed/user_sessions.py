"""How long three kinds of user need: each session is played in a browser or a shell, and its time is counted.

    python benchmarks/speed/user_sessions.py [teaching] [lighting] [renderer] [--screenshots FOLDER]

- teaching: from the clone to the hidden effect of the bundled capture, found by hand in the workbench, and saved;
- lighting: from a folder of frames without a manifest to the comparison and its report;
- renderer: from a renderer's test suite to a failing test that names the cause (`docs/red-build.md`).

A step fails if the page does not do what the person expects. The times of hands and head are those of the
keystroke-level model: a key 0.28 s, pointing 1.1 s, moving a hand between keyboard and mouse 0.4 s, preparing in the
head 1.35 s (Card, Moran & Newell 1980, doi:10.1145/358886.358895). Reading takes 238 words a minute (Brysbaert 2019,
doi:10.1016/j.jml.2019.104047); a page's words are counted where it is read. The model is of people who know what they
want, so a decision counts as several preparations, whose number each step states. Waiting is the CPU time of all
threads of the program with an empty cache. On a machine with nothing else to do it takes no longer. Downloads and
installation are not counted: they take what the network takes. Reckon with ten minutes.
"""

from __future__ import annotations

import argparse
import re
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.app.commands.demo_chain import DEMO_CAPTURE
from cboxlab.validation.app.studio import Workbench
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from helpers.pages.browser import Page, open_browser
from helpers.pages.server import served
from helpers.places import ROOT

#: Times of the keystroke-level model, s: a key or a click, pointing, a hand to the other device, preparing.
KEY_S, POINT_S, HAND_S, THINK_S = 0.28, 1.1, 0.4, 1.35
#: Words that are read in a second.
WORDS_PER_S = 238 / 60
#: Time after which the page is given up, s.
PATIENCE_S = 1800.0

#: Exposure times of the bundled capture's bands, and of their flats and references, s, as noted in the laboratory.
EXPOSURES = {"f400": "25", "f450": "2.5", "f500": "1", "f550": "0.6", "f600": "0.3", "f650": "0.25", "f700": "0.3"}
EVEN_EXPOSURES = {"f400": "20", "f450": "4", "f500": "1.5", "f550": "0.8", "f600": "0.5", "f650": "0.3", "f700": "0.4"}
#: What the data sheets of the bundled capture's camera, lens and lamp say: key, table, value.
DATA_SHEETS = (
    ("bit_depth", "[camera]", "12"),
    ("pixel_pitch_um", "[camera]", "195.3125"),
    ("gain_e_per_dn", "[camera]", "12"),
    ("focal_length_mm", "[lens]", "35"),
    ("f_number", "every [[band]]", "8"),
    ("image_distance_mm", "every [[band]]", "36.6"),
    ("relative_uncertainty", "[lamp]", "0.02"),
    ("point_sigma_px", "[geometry]", "0.15"),
)


@dataclass
class Step:
    """A step of a person, with the parts of its time."""

    name: str
    reading_s: float = 0.0
    thinking_s: float = 0.0
    hands_s: float = 0.0
    waiting_s: float = 0.0

    @property
    def total_s(self) -> float:
        return self.reading_s + self.thinking_s + self.hands_s + self.waiting_s


@dataclass
class Person:
    """Somebody at the keyboard, whose times are added up."""

    steps: list[Step] = field(default_factory=list)
    screenshots: Path | None = None
    at_mouse: bool = False

    def begins(self, name: str) -> None:
        self.steps.append(Step(name))

    def reads(self, text: str) -> None:
        self.steps[-1].reading_s += len(text.split()) / WORDS_PER_S

    def thinks(self, times: int = 1) -> None:
        self.steps[-1].thinking_s += times * THINK_S

    def types(self, text: str) -> None:
        """Keys; the page or the shell gets them from the caller."""
        self._hand(at_mouse=False)
        self.steps[-1].hands_s += KEY_S * len(text)

    def points(self) -> None:
        """Pointing and a click."""
        self._hand(at_mouse=True)
        self.steps[-1].hands_s += POINT_S + KEY_S

    def _hand(self, at_mouse: bool) -> None:
        if self.at_mouse != at_mouse:
            self.steps[-1].hands_s += HAND_S
            self.at_mouse = at_mouse

    @contextmanager
    def waits(self, who: int = resource.RUSAGE_SELF):
        start = _used(who)
        yield
        self.steps[-1].waiting_s += _used(who) - start


def _used(who: int) -> float:
    """CPU time of this program or of those that it started, s."""
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


class AtPage(Person):
    """A person in front of the workbench."""

    page: Page

    def clicks(self, selector: str) -> None:
        """Point at a control and press the mouse."""
        self.points()
        where = self.page.run(
            f"(() => {{const e = {_element(selector)}; e.scrollIntoView({{block: 'center'}});"
            "const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2, e.disabled === true]})()"
        )
        assert not where[2], f"{selector} cannot be pressed"
        self.page.click(*where[:2])

    def enters(self, selector: str, text: str, with_mouse: bool = True) -> None:
        """Go to a field, type, and leave it by the tabulator."""
        if with_mouse:
            self.clicks(selector)
        self.page.run(f"{_element(selector)}.focus(); document.activeElement.select?.()")
        self.page.call("Input.insertText", text=text)
        self.page.key("Tab")
        self.types(text + "\t")

    def chooses(self, selector: str, value: str) -> None:
        """Open a list and take an entry."""
        self.points()
        self.points()
        self.page.run(
            f"(() => {{const e = {_element(selector)}; e.value = '{value}'; e.dispatchEvent(new Event('change'))}})()"
        )

    def sees(self, condition: str) -> None:
        """Wait until something is in the page."""
        with self.waits():
            end = time.monotonic() + PATIENCE_S
            while not self.page._holds(condition):
                assert time.monotonic() < end, f"never true: {condition}"
                time.sleep(0.05)

    def text_of(self, selector: str) -> str:
        return str(self.page.run(f"{_element(selector)}.innerText"))

    def looks(self, name: str) -> None:
        if self.screenshots is not None:
            self.page.screenshot(self.screenshots / f"{name}.png")


def _element(selector: str) -> str:
    return f"document.querySelector({selector!r})"


def prose(page: str, first: str, last: str = "") -> str:
    """Text of a page of the manual from one heading to another one."""
    text = (ROOT / page).read_text(encoding="utf-8")
    text = text[text.index(first) :]
    return re.split(rf"^{last}", text, maxsplit=1, flags=re.MULTILINE)[0] if last else text


#: Conditions of the pages: the workbench shows a study and computes nothing; the form is checked.
READY = (
    "typeof events === 'object' && page.viewer !== null && page.record?.open && !page.job && !page.loading"
    " && !page.requests"
)
CHECKED = "document.body.dataset.busy === 'false'"


def teaching(person: AtPage, work: Path) -> None:
    """The hidden effect of the bundled capture, by hand."""
    shutil.copytree(DEMO_CAPTURE, work / "demo-capture")
    person.begins("read what the program does, and how it starts")
    person.reads(prose("README.md", "# cboxlab", "You need a Debian"))
    person.begins("read how the workbench is used")
    person.reads(prose("docs/studio.md", "# The workbench", "## What to do with it"))
    person.begins("install (without the download), start the workbench, wait for the first picture")
    person.types("git clone ADDRESS-OF-THE-REPOSITORY && cd cboxlab && make demo\n")
    person.types(".venv/bin/cbox studio validate/data/demo-capture\n")
    bench = Workbench(work, work / "cache")
    with person.waits():
        bench.open(work / "demo-capture", None, NO_PROGRESS)
    with served(bench) as address, open_browser() as page:
        person.page = page
        page.open(address)
        person.sees(READY)
        person.looks("teaching-1-opened")
        person.begins("look at the difference: where is the photograph brighter?")
        person.reads(person.text_of("#figures") + person.text_of("#picture"))
        person.thinks(4)
        person.begins("read the list of effects")
        person.reads(
            page.run("[...document.querySelectorAll('#new-effect option')].map((o) => o.textContent).join(' ')")
        )
        for effect in ("lamp-power", "gloss", "veiling-glare"):
            person.begins(f"compare the pattern of {effect} with the difference")
            person.chooses("#new-effect", effect)
            person.reads(person.text_of("#new-summary"))
            person.clicks("#pattern")
            person.sees("document.getElementById('pattern').getAttribute('aria-pressed') === 'true' && !page.requests")
            person.thinks(3)
            person.looks(f"teaching-2-{effect}")
        person.begins("add veiling-glare, fit it, read chi-square")
        person.clicks("#add")
        person.sees("page.controls.length === 1 && !page.requests")
        person.clicks("#fit-all")
        person.sees(f"{READY} && page.record.effects[0].values.fraction > 0")
        person.reads(person.text_of("#figures"))
        person.thinks(2)
        person.looks("teaching-3-fitted")
        chi2 = float(page.run("document.getElementById('chi2').textContent"))
        assert chi2 < 1.05, chi2
        person.begins("save the study")
        person.clicks("#show-save")
        person.enters("#save-folder", "glare")
        person.clicks("#save button")
        person.sees("document.getElementById('saved').textContent.includes('study.json')")
        assert (work / "glare" / "model.toml").is_file()
        assert page.errors == []


def lighting(person: AtPage, work: Path) -> None:
    """A first capture from a folder of frames, to the report of the comparison."""
    frames = work / "my-box"
    shutil.copytree(DEMO_CAPTURE / "frames", frames)
    shutil.copy(DEMO_CAPTURE / "points.csv", frames)
    shutil.copytree(DEMO_CAPTURE / "spectra", frames / "spectra")
    person.begins("read how a first capture is made, start the form")
    person.reads(prose("docs/how-to/first-capture-in-the-browser.md", "# "))
    person.types("cbox studio my-box\n")
    with served(Workbench(work, work / "cache")) as address, open_browser() as page:
        person.page = page
        page.open(f"{address}first.html?folder=my-box")
        person.sees(CHECKED)
        person.looks("lighting-1-opened")
        person.begins("look through the frames: is each in the right group?")
        person.reads(person.text_of("#frames"))
        person.thinks(5)

        def fills(key: str, where: str, value: str, with_mouse: bool) -> None:
            person.thinks()
            number = page.run(
                f"inputs().findIndex((e) => e.dataset.key === '{key}' && e.dataset.where.includes('{where}'))"
            )
            page.run(f"inputs()[{number}].setAttribute('data-next', '')")
            person.enters("input[data-next]", value, with_mouse)
            page.run("document.querySelector('[data-next]').removeAttribute('data-next')")
            person.sees(CHECKED)

        person.begins("copy the exposure times from the notes")
        for name, exposures in (("[[band]] of f", EXPOSURES), ("[[flat]] of flat-f", EVEN_EXPOSURES)):
            for k, (band, value) in enumerate(exposures.items()):
                fills("exposure_s", f"{name}{band[1:]}", value, k == 0)
        for k, (band, value) in enumerate(EVEN_EXPOSURES.items()):
            fills("exposure_s", f"[[reference]] of sphere-{band}", value, k == 0)
        person.begins("read and fill in the values of camera, lens, lamp and box")
        person.reads(person.text_of("[aria-label='Other values']"))
        fills("scene", "the top", "cornell-box", True)
        for key, where, value in DATA_SHEETS:
            fills(key, where, value, True)
        person.looks("lighting-2-filled")
        person.begins("check and write")
        person.reads(person.text_of("#result"))
        assert "No required value is missing. Nothing" in person.text_of("#lacking")
        person.clicks("#write")
        person.sees("document.getElementById('saved').innerText.includes('Written')")
        person.looks("lighting-3-written")
        person.begins("open it in the workbench: the first comparison")
        person.reads(person.text_of("#saved"))
        person.clicks("#saved a")
        person.sees(READY)
        person.looks("lighting-4-compared")
        person.reads(person.text_of("#figures") + person.text_of("#picture"))
        person.thinks(4)
        person.begins("save it with the report")
        person.clicks("#show-save")
        person.enters("#save-folder", "first")
        person.clicks("#save-report")
        person.clicks("#save button")
        person.sees("document.getElementById('saved').textContent.includes('report.html')")
        assert page.errors == []


def renderer(person: Person, work: Path) -> None:
    """A failing test of a renderer that names the cause; the renderer is Mitsuba."""
    text = prose("docs/red-build.md", "# ")
    script = re.search(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert script is not None
    lines = [line.split("   #")[0].rstrip() for line in script[1].splitlines() if not line.startswith("pip install")]
    person.begins("read the page")
    person.reads(text)
    person.begins(f"type its {len(lines) + 1} lines, and wait for renderings and tests")
    person.thinks(len(lines))
    person.types("\n".join(lines))
    python = Path(sys.executable).parent
    with person.waits(resource.RUSAGE_CHILDREN):
        done = subprocess.run(
            ["bash", "-c", "\n".join(lines)],
            cwd=work,
            env={"PATH": f"{python}:/usr/bin:/bin", "HOME": str(work), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
    person.begins("read the failure")
    failure = "\n".join(line for line in done.stdout.splitlines() if line.startswith("E  "))
    assert "named: path-depth (max_bounces 3)" in failure, done.stdout + done.stderr
    person.reads(failure)
    person.thinks(2)


#: By session, what it plays, and the time that it may take, min.
SESSIONS: dict[str, tuple[Callable[[AtPage, Path], None], float]] = {
    "teaching": (teaching, 8.0),
    "lighting": (lighting, 15.0),
    "renderer": (renderer, 15.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sessions", nargs="*", choices=[[], *SESSIONS], default=[])
    parser.add_argument("--screenshots", type=Path, help="folder for a picture of the page at each stage")
    arguments = parser.parse_args()
    if arguments.screenshots is not None:
        arguments.screenshots.mkdir(parents=True, exist_ok=True)
    late = False
    for name in arguments.sessions or SESSIONS:
        play, aim_min = SESSIONS[name]
        person = AtPage(screenshots=arguments.screenshots)
        with threadpool_limits(1), TemporaryDirectory() as work:
            play(person, Path(work))
        total = print_table(name, person.steps)
        print(f"\n{name}: {total / 60:.1f} min; the aim is {aim_min:g} min\n", flush=True)
        late |= total > 60 * aim_min
    raise SystemExit(late)


def print_table(name: str, steps: list[Step]) -> float:
    """A row for each step; returns the sum of all, s."""
    print(f"| {name} | reading, s | thinking | hands | waiting | all |\n|---|---|---|---|---|---|")
    for step in [*steps, Step("all", *(sum(getattr(s, part) for s in steps) for part in PARTS))]:
        print(f"| {step.name} | {' | '.join(f'{getattr(step, part):.0f}' for part in PARTS)} | {step.total_s:.0f} |")
    return sum(step.total_s for step in steps)


#: Parts of a step's time.
PARTS = ("reading_s", "thinking_s", "hands_s", "waiting_s")

if __name__ == "__main__":
    main()
