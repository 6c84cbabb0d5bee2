"""The fluidic pinball in the box of Deng et al. 2020, without actuators: for the solver alone. Units: D and U.

The front cylinder is at x = -1.299, nearer to the inflow than in `pinball`, the rear ones at x = 0. At Re 18 a
Hopf bifurcation makes the steady flow unstable, at Re 68 a pitchfork bifurcation gives the street a mean lift.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in
from manywake.suite import pinball
from manywake.suite.pinball import steady

__all__ = ["CASE", "REFERENCES"]

DENG = "Deng, Noack, Morzynski & Pastur 2020"
CASE = replace(
    pinball.CASE,
    reynolds=10,
    bodies=pinball.cylinders(-pinball.BEHIND),
    actuators=(),
    sensors=(),
    time_step=0.01,
    spin_up=300,
)
HOPF, PITCHFORK = f"{DENG}: Hopf bifurcation at Re 18", f"{DENG}: pitchfork bifurcation at Re 68"
REFERENCES = (
    *steady(10, 2.4506, 2.2884, 0.9094),
    *steady(30, 1.5435, 1.6138, 0.5386),
    Growth("a disturbance grows, Re 16", "grows", 0, 0.0, HOPF, reynolds=16),
    Growth("a disturbance grows, Re 20", "grows", 1, 0.0, HOPF, reynolds=20),
    Statistic("the street lifts, Re 60", "lifts", 0, 0.0, PITCHFORK, reynolds=60),
    Statistic("the street lifts, Re 75", "lifts", 1, 0.0, PITCHFORK, reynolds=75),
)
