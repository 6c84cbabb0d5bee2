"""Sizes and time steps that follow the Reynolds number."""

from dataclasses import replace

import pytest

from manywake.case import GODA, Sizes
from manywake.suite import cylinder_jets, lid_driven_cavity

PLAIN = replace(cylinder_jets.CASE, time_step=None)
UNIT = PLAIN.convective_time


def test_sizes_are_the_default_up_to_100_and_thinner_past_it():
    assert Sizes.at(40) == Sizes.at(100) == Sizes()
    assert Sizes.at(400).layer_height == pytest.approx(Sizes().layer_height / 2)  # a boundary layer's: Re^-1/2
    for name in ("body", "wake"):
        assert getattr(Sizes.at(1600), name) == pytest.approx(getattr(Sizes(), name) / 2)
    assert Sizes.at(400).far == Sizes().far


def test_a_size_that_is_given_stays_at_every_reynolds_number():
    assert Sizes.at(400, wake_axis=0.005, body=0.05) == replace(Sizes.at(400), wake_axis=0.005, body=0.05)


def test_sizes_of_no_reynolds_number_are_refused():
    with pytest.raises(ValueError, match="reynolds: got 0, wanted a positive number"):
        Sizes.at(0)


def test_the_default_step_is_the_scheme_s_at_100():
    assert PLAIN.dt == PLAIN.scheme.time_step * UNIT
    assert replace(PLAIN, scheme=GODA).dt == GODA.time_step * UNIT
    assert replace(PLAIN, reynolds=40).dt == PLAIN.dt


def test_the_default_step_shrinks_with_the_reynolds_number_and_with_sizes():
    coarse = [PLAIN.dt / replace(PLAIN, reynolds=re, sizes=Sizes()).dt for re in (100, 120, 200, 300, 400)]
    assert coarse == pytest.approx([1, 1, 2, 3, 4])  # baselines were made with 2 parts at Re 200, with 4 at 400
    parts = [PLAIN.dt / replace(PLAIN, reynolds=re, sizes=Sizes.at(re)).dt for re in (100, 120, 200, 300, 400)]
    assert parts == pytest.approx([1, 1, 2, 3, 4])
    assert replace(PLAIN, sizes=Sizes(body=Sizes().body / 4)).dt == pytest.approx(PLAIN.dt / 2)
    assert replace(PLAIN, sizes=Sizes(wake=2.0, body=1.0)).dt == PLAIN.dt  # never longer


def test_without_bodies_their_sizes_do_not_shorten_the_step():
    cavity = replace(lid_driven_cavity.CASE, reynolds=100, time_step=None)
    assert replace(cavity, sizes=Sizes(body=0.01)).dt == cavity.dt


@pytest.mark.parametrize("reynolds", range(40, 401, 20))
def test_an_interval_that_suits_the_scheme_s_step_suits_the_default_step(reynolds):
    cylinder_jets.TASK.steps(replace(PLAIN, reynolds=reynolds, sizes=Sizes.at(reynolds)).dt)


def test_a_step_that_is_given_is_taken():
    assert replace(PLAIN, reynolds=400, time_step=1e-3).dt == 1e-3
