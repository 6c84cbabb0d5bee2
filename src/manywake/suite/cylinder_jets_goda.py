"""The flow of cylinder-jets with the paper's first-order scheme and time step."""

from manywake.case import GODA, replace
from manywake.suite import cylinder_jets
from manywake.suite.cylinder_jets import LEARNING, PROTOCOLS, REFERENCES, REWARDS, TASK

__all__ = ["CASE", "LEARNING", "PROTOCOLS", "REFERENCES", "REWARDS", "TASK"]

CASE = replace(cylinder_jets.CASE, scheme=GODA, time_step=5e-4)
