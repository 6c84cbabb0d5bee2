"""Schedules: which episode is played by which policy, and when, against a naive simulation of the environments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from manywake.learn import schedule


def naive(seconds, environments, period, update_seconds):
    """Play it through: at every event, in order of time and index, environments end and versions get ready."""
    count = len(seconds)
    running, ready, log, started = {}, [0.0], {}, 0
    for _ in range(min(environments, count)):
        running[started] = (seconds[started], 0)
        started += 1
    arrived = []
    while running:
        index = min(running, key=lambda k: (running[k][0], k))
        now, version = running.pop(index)
        arrived.append(index)
        log[index] = (version, (len(arrived) - 1) // period, now)
        if len(arrived) % period == 0:
            ready.append(max(now, ready[-1]) + update_seconds)
        if started < count:
            newest = max(v for v, at in enumerate(ready) if at <= now)
            running[started] = (now + seconds[started], newest)
            started += 1
    return [log[k] for k in range(count)], ready[1:]


@given(st.integers(1, 70), st.integers(1, 25), st.integers(1, 6), st.floats(0, 12), st.integers(0, 99))
def test_the_unsynced_plan_is_what_a_naive_simulation_gives(environments, period, updates, update_seconds, seed):
    seconds = schedule.durations(seed, period * updates, 5.0, 0.1)
    plan = schedule.unsynced(seconds, environments, period, update_seconds)
    log, ready = naive(seconds, environments, period, update_seconds)
    assert list(zip(plan.version.tolist(), plan.update.tolist(), plan.time.tolist(), strict=True)) == log
    np.testing.assert_array_equal(plan.ready, ready)
    assert (plan.version <= plan.update).all()  # so that no update waits for an episode of a later policy
    assert (np.bincount(plan.update) == period).all()


def test_with_one_environment_unsynced_only_the_first_of_an_update_is_stale():
    plan = schedule.unsynced(np.full(12, 5.0), 1, 4, 0.3)
    np.testing.assert_array_equal(plan.update, np.repeat([0, 1, 2], 4))
    np.testing.assert_array_equal(plan.version, [0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2])


def test_sixty_environments_give_bursts_of_updates_with_old_policies():
    plan = schedule.unsynced(schedule.durations(0, 240, 5.0, 0.005), 60, 20, 0.1)
    staleness = plan.update - plan.version
    np.testing.assert_array_equal(np.unique(staleness[plan.update < 3]), [0, 1, 2])
    at_once = [plan.time[plan.update == u].max() <= plan.ready[u - 1] + 0.2 for u in range(1, 12)]
    assert at_once.count(True) >= 6  # two in three follow at once on the one before


@pytest.mark.parametrize("environments", [1, 2, 5, 10, 20])
def test_synced_time_falls_with_the_environments_and_versions_do_not_change(environments):
    plan = schedule.synced(np.full(60, 5.0), environments, 20, 0.3)
    np.testing.assert_array_equal(plan.version, np.repeat([0, 1, 2], 20))
    np.testing.assert_array_equal(plan.update, plan.version)
    assert plan.ready[-1] == pytest.approx(3 * (20 / environments * 5.0 + 0.3))


def test_durations_have_their_mean_and_spread_and_depend_on_run_and_episode_only():
    seconds = schedule.durations(3, 2000, 5.0, 0.03)
    assert seconds.mean() == pytest.approx(5.0, rel=0.005)
    assert seconds.std() == pytest.approx(0.15, rel=0.1)
    np.testing.assert_array_equal(seconds[:50], schedule.durations(3, 50, 5.0, 0.03))
    assert (schedule.durations(0, 500, 5.0, 2.0) >= 0.5).all()
