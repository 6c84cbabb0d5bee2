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


@given(st.integers(1, 70), st.integers(1, 25), st.integers(1, 6), st.floats(0, 12), st.integers(1, 9))
def test_an_environment_that_asks_again_gets_the_newest_policy_there_is(environments, period, updates, u, asks):
    seconds = schedule.durations(0, period * updates, 5.0, 0.1)
    once = schedule.unsynced(seconds, environments, period, u)
    plan = schedule.unsynced(seconds, environments, period, u, asks)
    for field in ("update", "time", "ready"):  # when is one thing, by whom another
        np.testing.assert_array_equal(getattr(plan, field), getattr(once, field))
    np.testing.assert_array_equal(plan.version[:, :1], once.version)
    for versions, end, long in zip(plan.version, plan.time, seconds, strict=True):
        asked = [end - long + long * k / asks for k in range(asks)]
        for version, at in zip(versions[1:], asked[1:], strict=True):
            assert abs(plan.ready - at).min() < 1e-9 or version == (plan.ready <= at).sum()
    assert (np.diff(plan.version, axis=1) >= 0).all()
    assert (plan.version[:, -1] <= plan.update).all()


def test_sixty_environments_that_ask_for_every_action_are_as_old_as_the_papers():
    plan = schedule.unsynced(schedule.durations(0, 300, 5.0, 0.005), 60, 20, 0.3, 80)
    last = plan.update - plan.version[:, -1]
    assert set(last.tolist()) == {0, 1, 2}
    late = plan.update >= 3  # of the first round all is of one policy
    assert (plan.update - plan.version[:, 0])[late].min() >= 3
    assert (plan.update[:, None] - plan.version)[late].mean() == pytest.approx(1.4, abs=0.3)


@given(st.integers(1, 70), st.integers(1, 25), st.integers(1, 6), st.floats(0, 12), st.integers(0, 99))
def test_the_unsynced_plan_is_what_a_naive_simulation_gives(environments, period, updates, update_seconds, seed):
    seconds = schedule.durations(seed, period * updates, 5.0, 0.1)
    plan = schedule.unsynced(seconds, environments, period, update_seconds)
    log, ready = naive(seconds, environments, period, update_seconds)
    assert list(zip(plan.version[:, 0].tolist(), plan.update.tolist(), plan.time.tolist(), strict=True)) == log
    np.testing.assert_array_equal(plan.ready, ready)
    assert (plan.version[:, 0] <= plan.update).all()  # so that no update waits for an episode of a later policy
    assert (np.bincount(plan.update) == period).all()


def test_with_one_environment_unsynced_only_the_first_of_an_update_is_stale():
    plan = schedule.unsynced(np.full(12, 5.0), 1, 4, 0.3)
    np.testing.assert_array_equal(plan.update, np.repeat([0, 1, 2], 4))
    np.testing.assert_array_equal(plan.version[:, 0], [0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2])


def test_sixty_environments_give_bursts_of_updates_with_old_policies():
    plan = schedule.unsynced(schedule.durations(0, 240, 5.0, 0.005), 60, 20, 0.1)
    staleness = plan.update - plan.version[:, 0]
    np.testing.assert_array_equal(np.unique(staleness[plan.update < 3]), [0, 1, 2])
    at_once = [plan.time[plan.update == u].max() <= plan.ready[u - 1] + 0.2 for u in range(1, 12)]
    assert at_once.count(True) >= 6  # two in three follow at once on the one before


@pytest.mark.parametrize("environments", [1, 2, 5, 10, 20])
def test_synced_time_falls_with_the_environments_and_versions_do_not_change(environments):
    plan = schedule.synced(np.full(60, 5.0), environments, 20, 0.3)
    np.testing.assert_array_equal(plan.version[:, 0], np.repeat([0, 1, 2], 20))
    np.testing.assert_array_equal(plan.update, plan.version[:, 0])
    assert plan.ready[-1] == pytest.approx(3 * (20 / environments * 5.0 + 0.3))


def test_durations_have_their_mean_and_spread_and_depend_on_run_and_episode_only():
    seconds = schedule.durations(3, 2000, 5.0, 0.03)
    assert seconds.mean() == pytest.approx(5.0, rel=0.005)
    assert seconds.std() == pytest.approx(0.15, rel=0.1)
    np.testing.assert_array_equal(seconds[:50], schedule.durations(3, 50, 5.0, 0.03))
    assert (schedule.durations(0, 500, 5.0, 2.0) >= 0.5).all()
