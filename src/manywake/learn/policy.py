"""A policy as plain arrays, and its forward pass: the same bits for every batch, and no torch where it plays."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from manywake.flow.batch import widths
from manywake.machine import disk, simd
from manywake.machine.compile import kernel
from manywake.machine.simd import fma, load, maximum, splat, store

HALF_LOG_TWO_PI = 0.9189385332046727  # a number and not a call, for the logarithms of two machines may differ
NORMALISED_LIMIT = 10.0
"""Normalised observations are clipped to +- this many standard deviations."""


@dataclass(frozen=True)
class Policy:
    """Snapshot of a Gaussian policy with ReLU layers.

    version: updates that made it. mean, deviation: (values,) of the observation normaliser. layers: pairs of weights
    (out, in) and biases (out,), single precision; the last gives the mean action; sums are double. log_std, std:
    (actions,).
    """

    version: int
    mean: np.ndarray
    deviation: np.ndarray
    layers: tuple[tuple[np.ndarray, np.ndarray], ...]
    log_std: np.ndarray
    std: np.ndarray

    def __call__(self, observation: np.ndarray) -> np.ndarray:
        """Return the mean action (actions,) or (B, actions) for an observation as it is, (values,) or (B, values)."""
        seen = np.asarray(observation, dtype=np.float64)
        if seen.ndim not in (1, 2) or seen.shape[-1] != len(self.mean):
            values = len(self.mean)
            raise ValueError(f"observation: got shape {seen.shape}, wanted ({values},), or a row of it for each flow")
        return act(self, np.atleast_2d(seen)).reshape(*seen.shape[:-1], -1).astype(np.float32)


@kernel
def _dense(weight, bias, x, floor, out):
    """Out = max(weight x + bias, floor), inputs summed in order."""
    for i in range(len(weight)):
        s = splat(bias[i], out)
        for k in range(weight.shape[1]):
            s = fma(weight[i, k], load(x, k, 0), s)
        store(out, i, 0, maximum(floor, s))


def write(policy: Policy, path: Path) -> None:
    """Write a policy, whole or not at all."""
    arrays = {**vars(policy), "version": np.array(policy.version)}
    for number, (weight, bias) in enumerate(arrays.pop("layers")):
        arrays |= {f"weight{number}": weight, f"bias{number}": bias}
    disk.write(path, lambda file: np.savez(file, **arrays))


def read(path: Path) -> Policy:
    """Read what `write` wrote; ValueError when the file is not there or damaged."""
    if not path.exists():
        raise ValueError(f"policy: {path} is not there, wanted a file that a training wrote")
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            count = sum(name.startswith("weight") for name in data.files)
            layers = tuple((data[f"weight{k}"], data[f"bias{k}"]) for k in range(count))
            return Policy(int(data["version"]), data["mean"], data["deviation"], layers, data["log_std"], data["std"])
    except disk.DAMAGE as error:
        raise ValueError(f"policy: {path} is damaged ({error})") from error


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


def draw(
    policies: Sequence[Policy], which: np.ndarray, observations: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return actions (B, actions) and log-probs (B,) for observations (B, values): row k is of policies[which[k]]."""
    actions, log_probs = np.empty(noise.shape, np.float32), np.empty(len(noise))
    for k in np.unique(which):
        rows = which == k
        mean = act(policies[k], observations[rows])
        actions[rows], log_probs[rows] = sample(policies[k], mean, noise[rows])
    return actions, log_probs


def sample(policy: Policy, mean: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return actions (B, actions) = mean + std noise, rounded to float32 as they are stored, and log-probs (B,)."""
    action = (mean + policy.std * noise).astype(np.float32)
    z = (action.astype(np.float64) - mean) / policy.std
    terms = -0.5 * z * z - policy.log_std - HALF_LOG_TWO_PI
    total = np.zeros(len(mean))
    for k in range(terms.shape[1]):
        total = total + terms[:, k]
    return action, total
