"""Learn how likely an effect only imitates a cause that nobody listed, and report how far that can be believed.

The first part simulates captures of several laboratories: a flaw of the base (`flawed_bases`) or none, and one effect
of the catalogue, one cause that the catalogue lacks (`outside_effects`), or nothing. The light is that of another
rendering. It replaces what a calibrated capture measured, whose fit is linear: so one laboratory serves for hundreds.
A sound capture by another simulator (--photographs) is a laboratory, too, with its own flaws and noise. Causes then
change it as the model predicts, with other rays. The best effect to first order is fitted and judged as a diagnosis
does. What it shows goes to --results, which a later run continues. The second part fits a logistic regression with a
ridge. It leaves each simulator, cause, flaw and laboratory out in turn, and prints the reliability of what was left
out, next to that of the package's table. With --write the weights become that table.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from itertools import chain, pairwise
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import imperfect_bases as bases
import numpy as np
from cboxlab.calibration.capture import load_capture
from cboxlab.rendering.chain import expected_signal, stages_between
from cboxlab.rendering.effects import AppliedEffect, catalogue
from cboxlab.utils.progress import NO_PROGRESS
from cboxlab.validation.compare import validate_capture
from cboxlab.validation.diagnose.alternatives import heldout_bands, heldout_pixels, is_edge_artefact
from cboxlab.validation.diagnose.evidence import (
    beyond_tolerance,
    least_gain,
    penalised,
    price_of,
    shape_error_of,
    square,
)
from cboxlab.validation.diagnose.explain import lead_of_forms
from cboxlab.validation.diagnose.explain.imitation import (
    FEATURES,
    Signs,
    imitation_probability,
)
from cboxlab.validation.diagnose.judgement import best_with_flaws, flaws_of, verdict_of
from cboxlab.validation.diagnose.linear_model import nuisance_columns
from cboxlab.validation.diagnose.linearised_fit import (
    LinearisedFit,
    linearised_fit,
    refitted_together,
    residual_with,
)
from cboxlab.validation.diagnose.search import Candidate, screen
from cboxlab.validation.diagnose.stepwise import signatures_of
from cboxlab.validation.diagnose.unexplained import residual_data_of
from cboxlab.validation.predict import sensing
from cboxlab.validation.synthetic.blind import draw_effect
from cboxlab.validation.synthetic.strengths import at_strength
from flawed_bases import BY_OTHERS, FLAWS
from numpy.typing import NDArray
from outside_effects import KEPT_BACK, NEIGHBOURS, OUTSIDE
from reliability import scores
from scipy.optimize import minimize
from scipy.special import expit

#: Side of the pictures, px.
SIZE_PX = 48

#: Chi2 per sample of a cause, the smallest and the largest.
LEAST, MOST = 0.04, 1.0

#: Chi2 per sample of a flaw over shot and read noise, the smallest and the largest: bases of simulators by others.
FLAWED = (0.06, 0.8)

#: Effects on geometry and light, which flaws of a base resemble: a third of the captures.
GEOMETRY = (
    "block-pose",
    "lamp-offset",
    "reflectance-gradient",
    "wall-reflectance",
    "lamp-directional",
    "lamp-nonuniform",
    "gloss",
    "haze",
    "defocus",
    "crosstalk",
)

#: What captures hold in turn.
KINDS = ("flaw", "effect", "geometry", "unlisted", "flaw", "geometry")

#: Least gain in samples held out of an effect that is selected.
LEAST_HELDOUT = 0.5

#: Standard deviation of the weights: with causes left out, 35 answers lose 0.39 on average, and 0.44 with 3.
RIDGE = 1.0

#: Another name of a flaw is neither right nor wrong.
DESCRIBES = {
    "leaning-blocks": {"block-pose"},
    "sizes": {"block-pose"},
    "tilted-walls": {"block-pose"},
    "astigmatism": {"defocus", "crosstalk"},
    "lamp-frame": {"lamp-directional"},
}

TABLE = Path(__file__).parents[2] / "validate" / "diagnose" / "explain" / "data" / "imitations.json"

#: Causes that the catalogue lacks.
UNLISTED = OUTSIDE | KEPT_BACK | NEIGHBOURS

Row = Mapping[str, Any]
Signal = NDArray[np.float64]


class Laboratory:
    """A calibrated capture of a sound box, and the light of an independent rendering."""

    def __init__(self, seed: int) -> None:
        self.seed: int | str = seed
        self.number = seed
        self.camera, settings = bases.laboratory_of(seed, SIZE_PX)
        self.image = bases.image_of("none", 0, seed, SIZE_PX)
        # tables and frames of the capture are read when they are needed
        self._temporary = TemporaryDirectory()
        folder, scene = Path(self._temporary.name) / "capture", bases.SCENE
        bases.photograph_image(folder, self.image, (), scene, scene, self.camera, settings=settings, seed=seed)
        self.validation = validate_capture(load_capture(folder), bases.MODEL)
        self._linearise()

    def _linearise(self) -> None:
        self.fit = linearised_fit(self.validation.prepared, self.validation.rendered, ())
        self.signatures = [s for s in signatures_of(self.fit, (), bases.MODEL.render, NO_PROGRESS) if not s.by_priors]
        self.problem = self.fit.problem(())

    def flaw(self, name: str, draw: np.random.Generator) -> tuple[str, tuple[AppliedEffect, ...]]:
        """A flaw of the base: its name, and its change of the light; none for a sound one."""
        change, _ = bases.flaw_of(name, int(self.seed), SIZE_PX, int(draw.integers(10**6)), FLAWED)
        return name, (change,) if change else ()

    @cached_property
    def sound(self) -> Signal:
        """(band, y, x) light of the sound box, DN."""
        return self.light(())

    def light(self, effects: Sequence[AppliedEffect]) -> Signal:
        """(band, y, x) DN without noise; what acts before the filters by patch transport with other rays."""
        early = tuple(e for e in effects if e.stage in stages_between("scene", "transport"))
        late = [e for e in effects if e not in early]
        calibration = self.validation.prepared.calibration
        signal = expected_signal(self.image, sensing(calibration, self.camera), late, self.camera)
        if early:
            predictor = self.fit.predictor.resampled()
            base = predictor.signal(())
            signal = signal * np.divide(predictor.signal(early), base, out=np.ones_like(base), where=base > 0)
        return np.asarray(signal)

    def measured(self, effects: Sequence[AppliedEffect], seed: int) -> Signal:
        """(band, y, x) DN of a photograph with effects, with fresh noise."""
        signal, calibration = self.light(effects), self.validation.prepared.calibration
        noise = np.random.default_rng([seed, 3]).standard_normal(signal.shape)
        return np.asarray(signal + noise * np.sqrt(calibration.predicted_variance(signal)))

    def excess(self, effect: AppliedEffect) -> float:
        """Chi2 per sample of an effect, the lamp's power free."""
        used, variance = self.fit.model.used, self.validation.prepared.calibration.predicted_variance(self.sound)
        level, change = (x[used] / np.sqrt(variance[used]) for x in (self.sound, self.light((effect,)) - self.sound))
        return float(np.mean((change - level * (level @ change) / (level @ level)) ** 2))

    def residual(self, effects: Sequence[AppliedEffect], seed: int) -> Signal:
        """(n + 11,) residual of the model as given."""
        model = self.fit.model
        change = self.measured(effects, seed) - self.validation.prepared.measured
        return model.residual + model.whiten_used(change[model.used])


class PhotographedLaboratory(Laboratory):
    """A sound capture by somebody else: its own flaws and noise, with causes on top of them."""

    def __init__(self, path: Path) -> None:
        self.seed = f"{path.parents[1].name}/{path.name}"
        self.number = crc32(self.seed.encode())
        self.validation = validate_capture(load_capture(path), bases.MODEL)
        self._linearise()

    def flaw(self, name: str, draw: np.random.Generator) -> tuple[str, tuple[AppliedEffect, ...]]:
        """The photograph's own flaws."""
        del name, draw
        return "its own", ()

    def light(self, effects: Sequence[AppliedEffect]) -> Signal:
        """(band, y, x) light of the fitted model, by patch transport with other rays, DN without noise."""
        return np.asarray(self.fit.scale * self.fit.predictor.resampled().signal(effects))

    def measured(self, effects: Sequence[AppliedEffect], seed: int) -> Signal:
        """(band, y, x) DN of the photograph, with the change by effects."""
        del seed
        return np.asarray(self.validation.prepared.measured + self.light(effects) - self.sound)


def cause(name: str, laboratory: Laboratory, draw: np.random.Generator) -> AppliedEffect | None:
    """A cause by name with numbers by chance; None where it cannot be as strong as drawn."""
    target = float(np.exp(draw.uniform(np.log(LEAST), np.log(MOST))))
    if name in UNLISTED:
        trial = AppliedEffect(UNLISTED[name], {"amount": 0.01, "row": draw.uniform(), "column": draw.uniform()})
    else:
        trial = draw_effect(draw, bases.SCENE, laboratory.validation.prepared.calibration.capture.band_ids, (name,))
    return at_strength(trial, target, laboratory.excess)


def signs_in(laboratory: Laboratory, residual: Signal) -> dict[str, Any] | None:
    """The effect that a diagnosis would select first, fitted, and what its tests show; None for none."""
    fit = replace(laboratory.fit, model=replace(laboratory.fit.model, residual=residual))
    first = min(screen(laboratory.problem, laboratory.signatures, residual), key=penalised)
    row = _row(laboratory, fit, first)
    if row is None:
        by_flaws = best_with_flaws(laboratory.problem, laboratory.signatures, flaws_of(fit, residual), residual, 0.0)
        row = None if by_flaws is None else _row(laboratory, fit, by_flaws)
    return row


def _row(laboratory: Laboratory, fit: LinearisedFit, screened: Candidate) -> dict[str, Any] | None:
    """What an effect shows when it is fitted; None where it would not be selected."""
    model, residual = fit.model, fit.model.residual
    (candidate,) = refitted_together(fit, [screened])
    rest = residual_with(fit, [candidate])
    change = residual - rest
    heldout = min(heldout_pixels(model, residual, change), np.nan_to_num(heldout_bands(model, residual, change), nan=1))
    by_size = square(residual) - square(rest) > least_gain(replace(candidate, predicted=change), model)
    if not by_size or not beyond_tolerance(candidate) or heldout < LEAST_HELDOUT:
        return None
    flaws = flaws_of(fit, rest)
    verdict = verdict_of(candidate, residual, rest, flaws)
    if not verdict.holds or is_edge_artefact(model, residual, change):
        return None
    capture = laboratory.validation.prepared.calibration.capture
    averaging = laboratory.problem.noise_averaging_gain(candidate.applied)
    data = residual_data_of(fit, residual, capture, nuisance_columns(model, flaws.errors))
    effect, price = candidate.hypothesis.effect, price_of(len(candidate.numbers))
    shape_error = shape_error_of(effect.stage)
    lead = lead_of_forms(data, rest[: data.count], price, averaging, shape_error, effect.acts_on_things).lead
    signs = Signs(verdict.gain, model.count, float(heldout), lead, parts=verdict.by_part.lead)
    return {"effect": verdict.effect, "signs": asdict(signs), "verdict": asdict(verdict)}


def simulate(results: Path, laboratories: Iterable[Laboratory], captures: int) -> None:
    """Append what is missing: flaws alone, effects and other causes in turn."""
    finished = {(str(row["laboratory"]), row["seed"]) for row in rows_of(results)}
    able = [name for name, e in catalogue().items() if e.stage not in ("settings", "camera")]
    able = [name for name in able if not catalogue()[name].imitates_lamp_power]
    causes = {"effect": able, "geometry": GEOMETRY, "unlisted": [*UNLISTED]}
    of_light = [name for name, flaw in FLAWS.items() if flaw.scene is None]
    for laboratory in laboratories:
        for index in range(captures):
            if (str(laboratory.seed), index) in finished:
                continue
            draw, kind = np.random.default_rng([laboratory.number, index, 5]), KINDS[index % len(KINDS)]
            flaw = str(draw.choice(of_light))
            if kind == "flaw" and flaw == "none":
                flaw = str(draw.choice(BY_OTHERS))
            by_kind = {each: str(draw.choice(names)) for each, names in causes.items()}
            name = by_kind.get(kind, "none")
            flaw, effects = laboratory.flaw(flaw, draw)
            if name != "none":
                effect = cause(name, laboratory, draw)
                if effect is None:
                    continue
                effects = (*effects, effect)
            answer = signs_in(laboratory, laboratory.residual(effects, 7000 + index))
            row = {"laboratory": laboratory.seed, "cause": name, "flaw": flaw, "seed": index, **(answer or {})}
            with results.open("a", encoding="utf-8") as out:
                out.write(json.dumps(row, default=float) + "\n")


def rows_of(results: Path) -> list[Row]:
    """Rows of a file that may not exist yet."""
    return [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()] if results.exists() else []


def samples_of(rows: Sequence[Row]) -> list[tuple[Row, NDArray[np.float64], bool]]:
    """Rows whose answer is an effect, their features, and whether it imitates what nobody listed, or a flaw.

    Another effect of the catalogue than the true one, and another name of the flaw, are left out.
    """
    return [
        (row, Signs(**row["signs"]).features, row["effect"] != row["cause"])
        for row in rows
        if "signs" in row
        and (row["cause"] in (*UNLISTED, "none") or row["effect"] == row["cause"])
        and not (row["effect"] != row["cause"] and row["effect"] in DESCRIBES.get(row["flaw"], ()))
    ]


def fit_weights(features: NDArray[np.float64], imitates: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Weights of a logistic regression by penalised likelihood; as many causes are tried as effects."""

    def loss(weights: NDArray[np.float64]) -> float:
        utility = features @ weights
        return float(np.sum(np.logaddexp(0, utility) - imitates * utility) + 0.5 * weights @ weights / RIDGE**2)

    return np.asarray(minimize(loss, np.zeros(features.shape[1]), method="L-BFGS-B").x)


def left_out(samples: Sequence[tuple[Row, NDArray, bool]], key: Callable[[Row], str]) -> Iterator[tuple[float, bool]]:
    """Probability of an imitation by a fit without the sample's group, and whether it is one."""
    groups, features = np.array([key(row) for row, *_ in samples]), np.array([f for _, f, _ in samples])
    imitates = np.array([i for *_, i in samples])
    for group in np.unique(groups):
        inside = groups == group
        weights = fit_weights(features[~inside], imitates[~inside])
        probability = expit(features[inside] @ weights)
        yield from zip(probability.tolist(), imitates[inside].tolist(), strict=True)


def simulator_of(row: Row) -> str:
    """The simulator that made a row's base: this one, or the folder of a photograph."""
    folder, _, capture = str(row["laboratory"]).rpartition("/")
    return folder if capture and folder else "this one"


def report(samples: Sequence[tuple[Row, NDArray, bool]]) -> None:
    """Reliability, log loss and Brier score of what was left out, and of the table that the package has."""
    now = [(imitation_probability(Signs(**row["signs"])), imitates) for row, _, imitates in samples]
    share = float(np.mean([imitates for *_, imitates in samples]))
    print(f"The package's table: {scores(now)}. The share alone: {scores([(share, i) for _, i in now])}.")
    keys = {"simulator": simulator_of, **{name: itemgetter(name) for name in ("cause", "flaw", "laboratory")}}
    for name, key in keys.items():
        answers = list(left_out(samples, lambda row, key=key: str(key(row))))  # type: ignore[misc]
        print(f"\nEach {name} left out, {len(answers)} captures, {scores(answers)}:\n")
        print("| probability of an imitation | captures | mean | imitations |\n|---|---|---|---|")
        for low, high in pairwise((0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0001)):
            some = [(p, i) for p, i in answers if low <= p < high]
            if some:
                mean, rate = (float(np.mean(x)) for x in zip(*some, strict=True))
                print(f"| {low:g} to {min(high, 1):g} | {len(some)} | {mean:.2f} | {rate:.2f} |")


def main() -> None:
    """Simulate, fit, report; write the table where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--results", type=Path, default=Path("imitations.jsonl"))
    parser.add_argument("--laboratories", type=int, default=2)
    parser.add_argument("--captures", type=int, default=0, help="effects of each laboratory; 0 simulates nothing")
    parser.add_argument("--photographs", type=Path, nargs="*", default=[], help="sound captures by other simulators")
    parser.add_argument("--write", action="store_true", help="replace the table of the package")
    options = parser.parse_args()
    if options.captures:
        simulated = (Laboratory(8950 + number) for number in range(options.laboratories))
        photographed = (PhotographedLaboratory(path) for path in options.photographs)
        simulate(options.results, chain(simulated, photographed), options.captures)
    samples = samples_of(rows_of(options.results))
    if len({imitates for *_, imitates in samples}) < 2:
        parser.exit(1, f"{options.results}: {len(samples)} answers, not of both kinds; simulate more (--captures)\n")
    report(samples)
    weights = fit_weights(np.array([f for _, f, _ in samples]), np.array([i for *_, i in samples]))
    table = {
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "captures": len(samples),
        "imitations": int(sum(i for *_, i in samples)),
        "weights": {name: round(float(w), 4) for name, w in zip(FEATURES, weights, strict=True)},
    }
    text = json.dumps(table, indent=1) + "\n"
    print(text)
    if options.write:
        TABLE.parent.mkdir(exist_ok=True)
        TABLE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
