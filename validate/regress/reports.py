"""An outcome for build servers: JUnit XML, and lines that GitHub shows beside a pull request."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from cboxlab.scenes.files import replacing

from .outcome import Outcome
from .pooled import PooledMean

__all__ = ["github_lines", "summary", "write_junit"]


def write_junit(path: Path, outcome: Outcome) -> None:
    """One test case for each pool but the blocks, which share one; a case fails where its pool decides."""
    rows = [row for row in outcome.pools if row.kind != "block"]
    blocks = [row for row in outcome.of_kind("block") if row.different]
    failures = sum(row.different for row in rows) + bool(blocks)
    suite = ET.Element(
        "testsuite", name="cbox regress", tests=str(len(rows) + 1), failures=str(failures), errors="0"
    )
    for row in rows:
        _case(suite, f"{row.kind}: {row.name}", [row] if row.different else [])
    _case(suite, "blocks", blocks)
    ET.SubElement(suite, "system-out").text = "\n".join([summary(outcome), *outcome.notes])
    with replacing(path) as temporary:
        ET.ElementTree(suite).write(temporary, encoding="utf-8", xml_declaration=True)


def _case(suite: ET.Element, name: str, failing: list[PooledMean]) -> None:
    case = ET.SubElement(suite, "testcase", classname="cbox.regress", name=name)
    for row in failing:
        ET.SubElement(case, "failure", message=_told(row))


def github_lines(outcome: Outcome) -> list[str]:
    """Workflow commands of GitHub Actions: an error where the pictures differ, a notice where not."""
    if outcome.same:
        return [f"::notice title=cbox regress::{_escaped(summary(outcome))}"]
    return [f"::error title=cbox regress::{_escaped(summary(outcome))}"] + [
        f"::error title=cbox regress::{_escaped(_told(row))}" for row in outcome.deciding[:3]
    ]


def summary(outcome: Outcome) -> str:
    """The verdict in one line."""
    whole = outcome.whole
    if outcome.same:
        return (
            f"same: mean light agrees within {outcome.equivalence_95:.3%} at 95 %; "
            f"{outcome.would_have_seen:.3%} would have been seen"
        )
    named = f", named {outcome.named[0].change} {outcome.named[0].parameters}" if outcome.named else ""
    return f"different: mean light {whole.difference:+.3%} +- {whole.sigma:.3%}{named}"


def _told(row: PooledMean) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{row.kind} {row.name}: {row.difference:+.4g}{unit} +- {row.sigma:.2g}, {abs(row.statistic):.1f} sigma"


def _escaped(text: str) -> str:
    return text.replace("%", "%25").replace("\n", "%0A")
