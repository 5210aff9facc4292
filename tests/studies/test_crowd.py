"""What a crowded sky costs."""

import threading

import pytest

from cogradar.shared.protocol.topics import Role
from studies.processes import crowd
from studies.processes.crowd import Crowd, Kind
from tests.services.tables import assert_shown_whole

ROLES = {role.value for role in Role} - {Role.OPERATOR.value}
CPU_MS: dict[str, float] = dict.fromkeys(ROLES, 1.0) | {Role.PLANNER.value: 15.0}
MEGABYTES: dict[str, float] = dict.fromkeys(ROLES, 100.0)


def test_what_a_crowd_costs_is_told_per_track_and_by_role() -> None:
    paced = Crowd(1.0, True, 10.0, 0.01, 0.0, 0.75, CPU_MS, MEGABYTES)
    whole, by_role = crowd.tables([paced, Crowd(9.0, False, 30.0, 0.0, 0.0, 0.1, CPU_MS, MEGABYTES)])
    assert_shown_whole([whole, by_role])
    assert [column.cell(whole.rows[0]) for column in whole.columns] == [
        *("10", "real time", "1.00", "1.00", "0.00", "75"),
        *("2.00", "1.50"),
    ]
    assert [column.cell(whole.rows[1]) for column in whole.columns][3:5] == ["-", "-"]
    assert len(by_role.rows) == 2 * len(ROLES)


@pytest.mark.nightly
@pytest.mark.zenoh
def test_a_small_crowd_is_measured() -> None:
    (found,) = crowd.measure(lambda _: None, threading.Event(), [Kind(6, 4.0, 80)])
    assert set(found.cpu_ms) == set(found.megabytes) == ROLES
    assert 3.0 < found.tracks <= 6.0  # also when the last look comes after the end
    assert 0.0 < found.spare < 1.0
    assert all(value > 0.0 for value in (*found.cpu_ms.values(), *found.megabytes.values()))
    assert found.rate_hz == pytest.approx(4.0, rel=0.1)
