"""The language of the code: faults of each kind may only become fewer (``python tests/words.py FOLDER`` lists them)."""

import json

import pytest
from architecture import MODULES, package_of
from words import LIMITS, SCRIPTS, counts, findings

LIMITED = json.loads(LIMITS.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def count_by_package():
    return counts()


@pytest.mark.parametrize("package", sorted({*map(package_of, MODULES), *SCRIPTS, "docs"}))
def test_faults_of_language_only_become_fewer(package, count_by_package):
    limits = LIMITED.get(package, {})
    excess = {name: count for name, count in count_by_package[package].items() if count > limits.get(name, 0)}
    assert excess == {}, f"python tests/words.py lists them; limits: {limits}"


SPOILT = '''
"""What this module does."""
FIRST, SECOND = 1, 2  # fmt: skip

def measure(found, known):
    """Tell the light of its own.

    found : a number.
    """
    own = found + known
    return own
'''


def test_every_measure_sees_its_fault(tmp_path):
    path = tmp_path / "module.py"
    path.write_text(SPOILT.lstrip())
    measures = {finding.measure for finding in findings(path)}
    assert {"nameless", "first-line", "section", "tuple-constant", "banned", "fmt-skip"} <= measures
