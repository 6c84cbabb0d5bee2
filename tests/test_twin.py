"""A twin on a finer mesh: it hears the noise of the flow, and a kept one is of that flow alone."""

import json

import numpy as np
import pytest

from manywake.case import BodyForce, Energy, Forced, Noise, Shear, Twin, describe, replace
from manywake.case import references as said
from manywake.flow import baseline, problem, statistics, steady, twin, validate
from manywake.flow.baseline import Baseline
from manywake.flow.batch import Start
from manywake.flow.disturb import Disturbances
from manywake.flow.stability import Withstood
from manywake.flow.store import Flow

from .conftest import TINY, tiny_mesh

NOISY = replace(
    TINY,
    reynolds=20.0,
    actuators=(),
    disturbances=(Noise(BodyForce("upstream", at=(0.15, 0.0), radius=0.05, along=(1.0, 1.0)), rms=60.0, time=0.02),),
    sensors=(Shear("gauge", "bottom"), Energy("energy")),
)
REFERENCE = Twin(("energy mean", "gauge rms"), tolerance=0.1, duration=0.2, settle=0.1)


@pytest.fixture(scope="module")
def flow():
    """The noisy channel, its baseline made of the steady flow alone."""
    posed = problem.pose(NOISY, tiny_mesh(NOISY))
    found = steady.solve(NOISY, posed)
    start = Start(found.u, found.u, found.p, *np.zeros((2, len(found.p))))
    none = statistics.Statistics("aperiodic", None, 0.0, {})
    withstood = Withstood(1.0, 1.0, (), np.zeros((0, 0)))
    still, digests = found.u, (describe.flow_digest(NOISY), describe.geometry_digest(NOISY))
    known = (start, start), found.u, np.zeros(len(still)), none, found.readings, withstood, "", still
    base = Baseline(*digests, posed.space.mesh, *known)
    return Flow(NOISY, baseline.assemble(NOISY, posed, *base.advecting), base)


def silent(what, share):
    pass


def test_halving_a_series_goes_straight_from_step_to_step(tiny):
    series = np.arange(24.0).reshape(4, 2, 3) ** 2
    found = twin.halved(series, np.zeros((2, 3)))
    assert (found[1::2] == series).all() and (found[0] == series[0] / 2).all()
    assert (found[2::2] == (series[1:] + series[:-1]) / 2).all()
    assert twin.halved(np.zeros((4, 0, 3)), np.zeros((0, 3))).shape == (8, 0, 3)  # of a flow without noise


def test_a_twin_agrees_with_its_flow_and_is_kept(flow, tmp_path):
    path = tmp_path / "noisy.json"
    checks = validate.twins(flow, REFERENCE, path, silent, True)
    assert [check.name for check in checks] == list(REFERENCE.of)
    assert all(check.passed and check.ours > 0 for check in checks)
    assert checks == validate.twins(flow, REFERENCE, path, silent, False)
    longer = replace(REFERENCE, duration=0.3)
    with pytest.raises(ValueError, match="got one for duration 0.2, wanted 0.3"):
        twin.kept(flow, longer, path)
    with pytest.raises(ValueError, match="--recompute"):
        twin.kept(flow, REFERENCE, tmp_path / "none.json")
    wrong = json.loads(path.read_text())
    wrong["readings"]["energy"]["mean"] *= 3
    path.write_text(json.dumps(wrong))
    assert not validate.twins(flow, REFERENCE, path, silent, False)[0].passed


def test_flows_of_a_twin_hear_the_noise_of_their_own_seed(flow):
    series = Disturbances(flow.operators, range(2)).series(100)
    assert abs(series[:, :, 0] - series[:, :, 1]).max() > 1
    assert (twin.halved(series, series[0])[1::2] == series).all()


@pytest.mark.parametrize(
    ("references", "message"),
    [
        ((replace(REFERENCE, of=("energy",)),), "got 'energy', wanted some of"),
        ((replace(REFERENCE, of=("c_d St",)),), "got 'c_d St'"),
        ((replace(REFERENCE, settle=0.2),), "got settle 0.2 of the duration 0.2"),
        ((REFERENCE, Forced((1.0,), (), 0.1, 1.0, 0.5)), "got two of Forced and Twin"),
    ],
)
def test_twins_that_do_not_fit_are_refused(references, message):
    with pytest.raises(ValueError, match=message):
        said.check(NOISY, references)
