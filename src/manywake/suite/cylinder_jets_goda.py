"""The flow of cylinder-jets with the paper's first-order scheme, its time step, and the mesh that went with them."""

from manywake.case import GODA, Sizes, replace
from manywake.suite import cylinder_jets
from manywake.suite.cylinder_jets import LEARNING, PROTOCOLS, REFERENCES, REWARDS, TASK

__all__ = ["CASE", "LEARNING", "PROTOCOLS", "REFERENCES", "REWARDS", "TASK"]

SIZES = Sizes(body=0.048, part_facets=2, layers=3, layer_height=0.034, wake=0.155, wake_axis=0.005, far=0.8)
CASE = replace(cylinder_jets.CASE, scheme=GODA, time_step=5e-4, sizes=SIZES)
