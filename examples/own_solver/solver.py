"""A wake in one complex number: the Landau-Stuart oscillator with forcing, as a program that speaks JSON lines.

Vortex shedding is a supercritical Hopf bifurcation. Close to its mean-field limit cycle the wake has one complex
amplitude A, scaled so that developed shedding has |A| = 1 (Noack et al., J. Fluid Mech. 497, 2003):

    dA/dt = sigma (1 - |A|^2) A + i (omega_0 + (omega_1 - omega_0) |A|^2) A + g q

with growth rate sigma, frequency omega_0 of the steady flow and omega_1 of developed shedding, and the jet's flow rate
q in [-1, 1] of gain g. The lift oscillates with the wake and the drag rises with the square of its amplitude:

    C_L = c_l Re A,    C_D = c_steady + c_shed |A|^2

and the probes, one behind another in the wake, see the passing vortices each at its phase: Re(A p_k), |p_k| = 1. The
figures of frequency, lift and drag are those of manywake's cylinder at Re 100, in units of 10 D and U-bar; growth rate
and gain are of a plausible size only. Time stepping: Runge-Kutta of order 4.

Protocol: a line in, a line out, both JSON; the program ends with its standard input.
    {"do": "reset", "seed": 7}    start on the limit cycle, at a phase that the seed decides
    {"do": "step", "jet": 0.3}    hold the jet for one action interval
    {"probes": [0.1, ...], "c_d": 3.19, "c_l": 0.2}    the answer to either
    {"error": "step before reset"}    when a line cannot be obeyed
"""

import json
import random
import sys

SIGMA = 1.5
OMEGA_0, OMEGA_1 = 16.1, 18.9  # 1.04 / 0.886 between them (Noack et al.); 18.9 is a period of 0.332
GAIN = 6.0
C_LIFT, C_STEADY, C_SHED = 0.986, 2.941, 0.254
PHASES = (1 + 0j, 0.8 - 0.6j, 0.28 - 0.96j, -0.352 - 0.936j)  # powers of (4 - 3i) / 5
INTERVAL, SUBSTEPS = 0.025, 10


def slope(a: complex, jet: float) -> complex:
    """Return dA/dt."""
    square = a.real * a.real + a.imag * a.imag
    return complex(SIGMA * (1 - square), OMEGA_0 + (OMEGA_1 - OMEGA_0) * square) * a + GAIN * jet


def start(seed: int) -> complex:
    """Return a point of the limit cycle; made without sine and cosine, whose last bit depends on the machine."""
    draw = random.Random(seed)
    t, sign = 2 * draw.random() - 1, draw.choice((-1, 1))
    return sign * complex(1 - t * t, 2 * t) / (1 + t * t)


def advance(a: complex, jet: float) -> complex:
    """Return A one action interval later."""
    dt = INTERVAL / SUBSTEPS
    for _ in range(SUBSTEPS):
        k1 = slope(a, jet)
        k2 = slope(a + dt / 2 * k1, jet)
        k3 = slope(a + dt / 2 * k2, jet)
        k4 = slope(a + dt * k3, jet)
        a += dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return a


def readings(a: complex) -> dict:
    """Return what is measured of the wake."""
    square = a.real * a.real + a.imag * a.imag
    return {
        "probes": [(a * phase).real for phase in PHASES],
        "c_d": C_STEADY + C_SHED * square,
        "c_l": C_LIFT * a.real,
    }


def main() -> None:
    """Answer line by line until the standard input ends."""
    a = None
    for line in sys.stdin:
        wish = json.loads(line)
        if wish["do"] == "reset":
            a = start(wish["seed"])
        elif wish["do"] == "step" and a is not None:
            a = advance(a, wish["jet"])
        else:
            print(json.dumps({"error": f"got {line.strip()}, wanted a reset, or a step after one"}), flush=True)
            continue
        print(json.dumps(readings(a)), flush=True)


if __name__ == "__main__":
    try:
        main()
    except BrokenPipeError:  # whoever asked is gone
        sys.stdout = None
