"""Progress: reports, shares of a whole, and how a computation is stopped."""

import pytest
from cboxlab.utils.progress import NO_PROGRESS, Cancelled, ProgressReporter, share


def reports_of(work):
    messages = []
    work(ProgressReporter(lambda stage, done: messages.append((stage, done))))
    return messages


def test_a_share_is_that_part_of_the_whole():
    def work(progress):
        progress.stage("first")
        share(progress, 0.2, 0.6).part(0.5)
        nested = share(share(progress, 0.5, 1.0), 0.5, 1.0)
        nested.stage("second")
        nested.part(1.0)

    assert reports_of(work) == [
        ("first", 0.0),
        ("first", pytest.approx(0.4)),
        ("second", pytest.approx(0.4)),
        ("second", 1.0),
    ]


def test_cancelled_at_the_next_step_whatever_it_is():
    for step in (lambda p: p.stage("next"), lambda p: p.part(0.5), lambda p: share(p, 0, 1).part(0.5)):
        stages = []
        progress = ProgressReporter(lambda stage, done, stages=stages: stages.append(stage))
        progress.cancel()
        with pytest.raises(Cancelled):
            step(progress)
        assert stages == []
    NO_PROGRESS.part(0.5)
