"""Baselines: what is shipped is whole and belongs to its case, and what is not whole is refused."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import stats

from manywake.case import Pressure
from manywake.case.describe import flow_digest
from manywake.flow import baseline, problem, spinup, stability, statistics, store
from manywake.flow import batch as batches
from manywake.flow.batch import FlowBatch
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE

cases = pytest.mark.parametrize("name", load.names())
streets = pytest.mark.parametrize("name", [name for name in load.names() if len(load.load(name).case.bodies) == 1])


def kept(name="cylinder-jets"):
    """Return a shipped case, and the path of its baseline, beside its file."""
    definition = load.load(name)
    return definition.case, definition.file.with_suffix(".npz")


def rewritten(source, target, **changes):
    """Copy a baseline file with some of its arrays changed; return the copy's path."""
    with np.load(source) as data:
        arrays = {key: data[key] for key in data.files}
    for key, change in changes.items():
        arrays[key] = change(arrays[key])
    np.savez_compressed(target, **arrays)
    return target


@cases
def test_shipped_baselines_match_their_hash_and_their_case(name):
    chosen, path = kept(name)
    loaded = baseline.load(path, chosen)
    with np.load(path) as data:
        assert loaded.digest() == json.loads(str(data["description"]))["digest"]
    assert loaded.flow_digest == flow_digest(chosen)
    assert len(loaded.withstood.samples) <= stability.SAMPLES
    assert loaded.mean.shape == loaded.start.u.shape
    sides = {side.name for side in chosen.domain.sides()}
    pieces = {piece.name for body in chosen.bodies for piece in body.pieces()}
    assert set(loaded.mesh.boundaries) == sides | pieces
    assert set(loaded.mesh.curves) == pieces


def test_every_baseline_that_is_shipped_is_of_a_shipped_case():
    assert store.shipped() == sorted(kept(name)[1] for name in load.names())


@streets
def test_start_state_continues_the_karman_street(name):
    chosen, _ = kept(name)
    flow = store.flow(chosen)
    ops, base = flow.operators, flow.baseline
    assert base.statistics.kind == "periodic"
    period = int(round(base.statistics.period / chosen.dt))
    record = spinup.free_run(FlowBatch(ops, base.start, 1), period)
    c_d, c_l = record["c_d"][:, 0], record["c_l"][:, 0]
    assert c_d.mean() == pytest.approx(base.statistics["c_d"].mean, rel=1e-3)
    assert c_d.max() == pytest.approx(base.statistics["c_d"].high, rel=1e-3)
    assert c_l.max() == pytest.approx(base.statistics["c_l"].high, rel=1e-2)
    # it starts at an upward crossing of the middle of C_L
    assert abs(c_l[0] - 0.5 * (c_l.max() + c_l.min())) < 0.05
    assert c_l[10] > c_l[0]
    # and the mean of each reading is that of the statistics
    body = chosen.bodies[0].name
    assert base.free["c_d"] == base.free[f"c_d.{body}"] == base.statistics["c_d"].mean
    assert base.free["c_l"] == base.free[f"c_l.{body}"] == base.statistics["c_l"].mean


@streets
def test_steady_flow_has_less_drag_than_shedding(name):
    chosen, path = kept(name)
    base = baseline.load(path, chosen)
    assert base.steady["c_d"] < base.statistics["c_d"].low


def test_the_pinball_starts_in_either_of_two_mirror_states():
    chosen, _ = kept("pinball")
    flow = store.flow(chosen)
    starts = flow.baseline.starts
    batch = batches.started(flow.operators, starts, len(starts))
    lift = spinup.free_run(batch, round(flow.baseline.statistics.period / chosen.dt))["c_l"].mean(axis=0)
    assert (lift[::2] > 0.03).all() and (lift[1::2] < -0.03).all()
    assert abs(flow.baseline.free["c_l"]) < 0.01  # they cancel
    assert load.load("pinball").task.starts == "any"


def test_every_limit_of_the_pinball_was_withstood_at_full_strength():
    chosen, path = kept("pinball")
    tried = baseline.load(path, chosen).withstood
    for actuator in chosen.actuators:
        assert actuator.limit <= min(tried.held, tried.smooth) * actuator.strongest


def test_a_saved_baseline_is_the_same_when_loaded(base, tmp_path):
    path = tmp_path / "deep" / "copy.npz"
    baseline.save(base, path)
    copy = baseline.load(path, CASE)
    assert copy.digest() == base.digest()
    assert (copy.statistics, copy.free, copy.steady) == (base.statistics, base.free, base.steady)
    assert copy.withstood.plain() == base.withstood.plain()
    assert [file.name for file in path.parent.iterdir()] == ["copy.npz"]


SENSORS = (Pressure("mine", ((0.3, 0.0),)),)


def nudged(array):
    array = array.copy()
    array.flat[0] = np.nextafter(array.flat[0], np.inf)
    return array


@pytest.mark.parametrize("part", ["start_u", "start_phi_old", "points", "mean"])
def test_a_file_with_a_changed_number_is_refused(part, tmp_path):
    path = rewritten(kept()[1], tmp_path / "bad.npz", **{part: nudged})
    with pytest.raises(ValueError, match="does not match its hash; delete the file and run again"):
        baseline.load(path, CASE)


@pytest.mark.parametrize("name", ["mean", "high"])
def test_a_file_with_a_changed_uncontrolled_drag_is_refused(name, tmp_path):
    def cheaper(description):
        changed = str(description).replace(f'"{name}": 3.', f'"{name}": 4.')
        assert changed != str(description)
        return np.array(changed)

    path = rewritten(kept()[1], tmp_path / "bad.npz", description=cheaper)
    with pytest.raises(ValueError, match="does not match its hash"):
        baseline.load(path, CASE)


def test_a_file_of_another_flow_is_refused():
    with pytest.raises(ValueError, match="is of another flow than this case; make it anew"):
        baseline.load(kept("cylinder-jets-goda")[1], CASE)


def test_a_file_cut_short_is_refused_with_remedy(tmp_path):
    path = tmp_path / "short.npz"
    path.write_bytes(kept()[1].read_bytes()[:100_000])
    try:
        baseline.load(path, CASE)
        answer = "loaded"
    except Exception as error:  # kept as text: the traceback would hold the file open beyond this test
        answer = f"{type(error).__name__}: {error}"
    assert answer.startswith("ValueError")
    assert "delete the file and run again" in answer


def test_an_unwritable_cache_is_refused_with_remedy(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("a file is no folder, for root neither")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "below"))
    with pytest.raises(RuntimeError, match="cache: cannot write .*; make it writable or set XDG_CACHE_HOME"):
        store.get(dataclasses.replace(CASE, time_step=4e-4))


def test_the_cache_tells_flows_apart_and_lies_where_the_user_wants(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    one = dataclasses.replace(CASE, time_step=4e-4)
    assert tmp_path in store.cache_path(one).parents
    assert store.cache_path(one) == store.cache_path(dataclasses.replace(one, sensors=SENSORS))
    assert store.cache_path(one) != store.cache_path(dataclasses.replace(one, reynolds=90.0))


def test_a_case_with_other_sensors_but_the_same_flow_uses_the_shipped_baseline(base):
    found = store.get(dataclasses.replace(CASE, sensors=SENSORS))
    assert found.digest() == base.digest()


def test_phases_are_spread_over_one_period(ops, base):
    states = baseline.phases(ops, base, 2, 0.1)
    assert len(states) == 2
    np.testing.assert_array_equal(states[0].u, base.start.u)
    flow = FlowBatch(ops, states[1], 1)
    _, c_l = flow.advance(np.zeros((10, 2, 1)))[:, :2, 0].T
    # half a period on, C_L crosses its middle downwards
    assert c_l[9] < c_l[0]
    assert abs(c_l[0] - base.statistics["c_l"].mean) < 0.2


def test_kicked_rest_is_at_rest_but_for_the_gust(ops):
    start = spinup.kicked(CASE, ops, 0.3)
    assert not start.u[:, 0].any()
    assert 0.2 < start.u[:, 1].max() <= 0.3
    assert not start.u[ops.velocity_order[ops.free :]].any()
    assert problem.boundary_flux(ops.space, ops.space.facets("cylinder"), start.u)[0] == pytest.approx(0.0, abs=1e-15)


def test_an_interval_of_95_per_cent_is_two_sided():
    values = np.random.default_rng(1).normal(size=7)
    low, high = stats.t.interval(0.95, 6, loc=values.mean(), scale=stats.sem(values))
    assert statistics.half_width(values) == pytest.approx((high - low) / 2, rel=1e-9)
