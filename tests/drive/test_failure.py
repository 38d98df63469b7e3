"""A run has failed off the road, spun or not finite: when, and why, by one rule that everything shares."""

import numpy as np
import pytest
from tests.drive.test_metrics import NAN, record

from adaptrack.base.errors import InvalidInput
from adaptrack.drive.failure import FailureLimits, Reason, find_failure


def test_a_run_has_failed_beyond_the_limit_not_on_it():
    assert find_failure(record(Y=5.0)) is None
    left = np.array([0.0, 1.0, 4.0, 5.1, 6.0, 0.0, 0.0, 0.0])
    failed = find_failure(record(Y=left))
    assert (failed.step, failed.time) == (3, pytest.approx(0.3))
    assert failed.clause == "left the road (more than 5 m from the reference)"
    assert find_failure(record(Y=left), FailureLimits(distance=7.0)) is None


def test_a_large_step_is_judged_once_it_has_arrived_and_has_failed_from_its_start_if_never():
    approach = np.array([0.0, 2.0, 6.0, 9.5, 12.0, 14.0, 14.5, 14.0])
    assert find_failure(record(Y=approach, y_ref=14.0)) is None
    runaway = np.array([0.0, 2.0, 6.0, 9.5, 12.0, 14.0, 18.0, 19.5])
    assert find_failure(record(Y=runaway, y_ref=14.0)).step == 7
    failed = find_failure(record(Y=0.0, y_ref=14.0))
    assert (failed.step, failed.clause) == (0, "never came within 5 m of the reference")


def test_a_spin_is_a_failure_at_driving_speed_only_and_the_first_event_gives_the_reason():
    sideways = np.array([0.0, 0.0, 9.0, 11.0, 11.0, 11.0, 11.0, 11.0])
    first = record(vy=[0, 0, 20, 20, NAN, NAN, NAN, NAN], Y=[0, 0, 0, 6, 7, 8, 9, 10])
    for run, step in ((record(vy=sideways), 3), (record(vy=-sideways), 3), (first, 2)):
        failed = find_failure(run)
        assert failed.step == step
        assert failed.clause.startswith("spun")
    assert find_failure(record(vx=0.05, vy=0.5)) is None
    assert find_failure(record(vx=-10.0)).step == 0  # going backwards


@pytest.mark.parametrize("limits", [{"distance": 0.0}, {"distance": NAN}, {"sideslip": -1.0}, {"sideslip": "wide"}])
def test_a_limit_that_makes_no_sense_is_refused(limits):
    with pytest.raises(InvalidInput, match="FailureLimits: "):
        FailureLimits(**limits)


def test_what_the_loop_knew_counts_when_it_came_first():
    Y = np.array([0.0, 1.0, 3.0, 4.0, NAN, NAN, NAN, NAN])  # the loop saw 5.2 m at the end of the fourth period
    failed = find_failure(record(Y=Y, failed="off-road", failed_at=0.4))
    assert (failed.step, failed.reason) == (4, Reason.OFF_ROAD)
    late = find_failure(record(Y=[0, 0, 6, 6, 6, 6, 6, 6], failed="spun", failed_at=0.5))
    assert (late.step, late.reason) == (2, Reason.OFF_ROAD)
    failure = find_failure(record(failed="battery empty", failed_at=0.8))
    assert (failure.step, failure.clause) == (7, "was stopped by its simulation: battery empty")
