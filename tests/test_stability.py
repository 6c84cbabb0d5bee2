"""No controller breaks a flow, and where one did, it would not pay."""

import dataclasses

import numpy as np
import pytest

from manywake.case import Box, Circle, Held, Jet, Linear, NoSlip, Rotation, Stream
from manywake.case.case import Case
from manywake.env.control import ControlledFlows
from manywake.flow import stability, store
from manywake.flow.stability import Withstood
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

NAMED = [(name, reward) for name in load.names() for reward in load.load(name).rewards]


def turned(**settings):
    three = (Circle("a", (0, 0), 0.5), Circle("b", (2, 1.5), 0.5), Circle("c", (2, -1.5), 0.5))
    spun = tuple(Rotation(body.name, 1.0) for body in three)
    return Case(100, Box((-6, 8), (-6, 6)), (Stream("left", "right", "bottom", "top"),), three, spun, **settings)


def test_every_sign_pattern_is_tried_once():
    assert sorted(map(tuple, stability.patterns(CASE))) == [(1.0, -1.0), (1.0, 1.0)]
    found = stability.patterns(turned())
    assert len(found) == len(set(map(tuple, found))) == 4
    assert (found[:, 0] == 1.0).all()


def test_without_an_open_end_no_pattern_has_a_net_flux():
    closed = (NoSlip("left", "right", "bottom", "top"),)
    case = dataclasses.replace(CASE, conditions=closed)
    assert stability.patterns(case).tolist() == [[1.0, -1.0]]


def withstood(held, smooth):
    return Withstood(held, smooth, (), np.zeros((0, 0)))


def test_a_limit_above_what_was_withstood_is_refused_with_the_number():
    stability.check(CASE, withstood(1.0, 1.0), Held())
    stability.check(CASE, withstood(0.8, 1.0), TASK.law)  # smooth as it is
    with pytest.raises(
        ValueError, match="got 0.01 on 'cylinder.top', wanted at most 0.008, .*a law that takes 0.0045 to"
    ):
        stability.check(CASE, withstood(0.8, 1.0), Held())
    with pytest.raises(ValueError, match="wanted at most 0.005"):
        stability.check(CASE, withstood(0.5, 0.5), Linear())
    weaker = (Jet("cylinder.top", 0.008), Jet("cylinder.bottom", 0.008))
    made = tuple(dataclasses.replace(jet, strength=0.01) for jet in weaker)
    stability.check(dataclasses.replace(CASE, actuators=made), withstood(0.8, 1.0), Held())


def test_a_smaller_limit_shares_the_baseline_and_a_larger_one_does_not(base):
    smaller, larger = (load.choose("cylinder-jets", limit=limit).case for limit in (0.005, 0.02))
    assert store.get(smaller).digest() == base.digest()
    assert store.cache_path(larger) != store.cache_path(CASE)
    assert store.cache_path(smaller) == store.cache_path(CASE)


@pytest.mark.parametrize("name, reward", NAMED)
def test_a_blow_up_is_charged_below_anything_that_staying_costs(name, reward):
    definition = load.load(name)
    chosen = load.choose(name, reward=reward, law="held" if name == "cylinder-jets" else "linear")
    flow = store.flow(definition.case)
    limit = tuple(dataclasses.replace(a, limit=a.limit * flow.baseline.withstood.held) for a in chosen.case.actuators)
    flow = dataclasses.replace(flow, case=dataclasses.replace(chosen.case, actuators=limit))
    flows = ControlledFlows(flow, chosen.task, 4)
    actions, rng, worst = flows.mixing.shape[1], np.random.default_rng(0), np.inf
    period = flow.baseline.statistics.period or 5 * flow.case.convective_time
    for t in range(20):
        square = np.sign(np.sin(2 * np.pi * (t * chosen.task.interval / period + 0.1)))
        each = np.stack([np.ones(actions), -np.ones(actions), np.full(actions, square), rng.choice([-1, 1], actions)])
        worst = min(worst, flows.act(each).reward.min())
    assert flows.charge < worst
