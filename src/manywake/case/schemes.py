"""Schemes of the time stepping: the coefficients of docs/numerics.md, eq. 4-7."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Scheme:
    """Coefficients of the time stepping, docs/numerics.md eq. 4-7; `BDF2_MEAN`, `BDF2` and `GODA` are the ones to use.

    Time steps are in convective units, L / U of the case's scales.
    """

    name: str
    new: float
    """Weight of u at t + dt in the time derivative."""
    history: tuple[float, float]
    """Minus the weights of u at t and t - dt in the time derivative."""
    ahead: float
    """Steps of the last increment by which u at t is extrapolated to the velocity e that the residual is of: e = u +
    ahead (u - u_old)."""
    pressure: tuple[float, float]
    """Weights of the last two pressure increments in the pressure of the momentum equation."""
    implicit: float
    """Share of the viscous term's increment taken at t + dt; 1/2 is Crank-Nicolson."""
    time_step: float
    """Time step of a case that names none."""
    largest: float
    """Largest time step with which a wake at Re 100 was ever stable."""
    mean: bool = False
    """Whether advection by the mean flow is taken at t + dt too, so that only the fluctuation is explicit."""
    damping: float = 0.0
    """A viscosity that acts on the error of the extrapolation alone: its size over dt V^2, where V, the largest
    departure from the mean flow under forcing, is too fast for the step."""

    @property
    def order(self) -> int:
        """Order in time: 2 where u is extrapolated, 1 where it is taken as it was."""
        return 2 if self.ahead else 1


BDF2 = Scheme("bdf2", 1.5, (2.0, -0.5), 1.0, (4 / 3, -1 / 3), 1.0, time_step=0.005, largest=0.006)
"""Second order: BDF2 with extrapolated explicit convection."""
BDF2_MEAN = Scheme(
    "bdf2-mean", 1.5, (2.0, -0.5), 1.0, (4 / 3, -1 / 3), 1.0, time_step=0.01, largest=0.0125, mean=True, damping=0.5
)
"""The default. Second order as BDF2, but the uncontrolled flow's mean advects implicitly, which allows larger steps."""
GODA = Scheme("goda", 1.0, (1.0, 0.0), 0.0, (1.0, 0.0), 0.5, time_step=0.005, largest=0.006)
"""First order (Goda 1979): forward Euler convection, Crank-Nicolson viscosity."""

SCHEMES = {scheme.name: scheme for scheme in (BDF2_MEAN, BDF2, GODA)}
"""Those that there are, by name."""
