"""The examples with other libraries' learners learn: the drag falls below that of no control."""

from importlib import import_module

import pytest


@pytest.mark.filterwarnings("ignore")  # of the libraries
@pytest.mark.parametrize(("name", "saved"), [("train_cleanrl", 0.05), ("train_torchrl", 0.05)])
def test_ppo_in_other_words_learns(name, saved):
    assert import_module(f"examples.{name}").train(episodes=256) > saved


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_stable_baselines3_learns(algorithm):
    from examples import train_sb3

    assert train_sb3.drag_saved(train_sb3.train(algorithm)) > 0.06


@pytest.mark.filterwarnings("ignore")
def test_skrl_learns():
    from examples import train_skrl

    assert train_skrl.saved(train_skrl.train()) > 0.05
