"""Feedback by hand on the paper's cylinder: two lines that calm the wake, from two probes or from the lift.

manywake evaluate --controller examples.feedback:from_probes
manywake evaluate --controller examples.feedback:from_lift

Found by trying all 69 pairs of probes that are mirror images, with gains of 0.3 and 1 and both signs.
"""

UPPER, LOWER = 11, 9
"""Probes at (0.1, 0.05) and (0.1, -0.05), half a diameter behind the cylinder."""


def from_probes(observation, info):
    """Blow from the top, and suck at the bottom, where the pressure is higher above the wake than below it."""
    return [min(max(float(observation[UPPER] - observation[LOWER]), -1.0), 1.0)]


def from_lift(observation, info):
    """The same by the lift, which a wind tunnel's balance gives; info has it from the first action on."""
    return [min(max(-0.1 * info.get("c_l", 0.0), -1.0), 1.0)]
