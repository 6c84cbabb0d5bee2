"""A policy as plain arrays, and its forward pass: the same bits for every batch, and no torch where it plays."""

from dataclasses import dataclass

import numpy as np

from manywake.flow import simd
from manywake.flow.batch import widths
from manywake.flow.kernels import kernel
from manywake.flow.simd import fma, load, maximum, splat, store

NORMALISED_LIMIT = 10.0
"""Normalised observations are clipped to +- this many standard deviations."""


@dataclass(frozen=True)
class Policy:
    """Snapshot of a Gaussian policy with ReLU layers.

    version: how many updates made it. mean, deviation: (values,) of the observation normaliser. layers: pairs of
    weights (out, in) and biases (out,), all double; the last gives the mean action. log_std, std: (actions,).
    """

    version: int
    mean: np.ndarray
    deviation: np.ndarray
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    log_std: np.ndarray
    std: np.ndarray


@kernel
def _dense(weight, bias, x, floor, out):
    """Out = max(weight x + bias, floor), inputs summed in order."""
    for i in range(len(weight)):
        s = splat(bias[i], out)
        for k in range(weight.shape[1]):
            s = fma(weight[i, k], load(x, k, 0), s)
        store(out, i, 0, maximum(floor, s))


def act(policy: Policy, observations: np.ndarray) -> np.ndarray:
    """Return the mean actions (B, actions) for observations (B, values)."""
    scaled = (observations.astype(np.float64) - policy.mean) / policy.deviation
    scaled = np.clip(scaled, -NORMALISED_LIMIT, NORMALISED_LIMIT)
    parts, column = [], 0
    for width in widths(len(scaled)):
        block = scaled[column : column + width]
        x = simd.zeros((block.shape[1], 1), width)
        simd.numbers(x)[:, 0, : len(block)] = block.T
        for number, (weight, bias) in enumerate(policy.layers):
            out = simd.zeros((len(bias), 1), width)
            _dense(weight, bias, x, 0.0 if number < len(policy.layers) - 1 else -np.inf, out)
            x = out
        parts.append(simd.numbers(x)[:, 0, : len(block)].T)
        column += width
    return np.concatenate(parts)


def sample(policy: Policy, mean: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return actions (B, actions) = mean + std noise, rounded to float32 as they are stored, and log-probs (B,)."""
    action = (mean + policy.std * noise).astype(np.float32)
    z = (action.astype(np.float64) - mean) / policy.std
    terms = -0.5 * z * z - policy.log_std - 0.5 * np.log(2 * np.pi)
    total = np.zeros(len(mean))
    for k in range(terms.shape[1]):
        total = total + terms[:, k]
    return action, total
