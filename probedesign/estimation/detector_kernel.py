"""The sequential test's arithmetic, compiled: bounded work a sample, no memory but its own."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from probedesign.frames import Array
from probedesign.rod.kernels.compiled import drop_stale, inner, kernel

drop_stale(Path(__file__).parent)

LENGTHS = (1, 4, 16, 64, 256, 1024)
RATIO = 4
FREE, CONTACT, LOST, INVALID = 0, 1, 2, 3
STATE_NOW, DETECTED_BY, DOUBT, WALK = 0, 1, 2, 3


class Memory(NamedTuple):
    """What the test keeps from sample to sample; lengths have their places in `LENGTHS`.

    Attributes:
        whiten: of a sample, (6, 6).
        thresholds: of T² for each length, (6,).
        released: T² below which a touch is over.
        gain: of the bias.
        trusted: weight of the identity in the covariances, and how many means they remember.
        state: what was said last, by which length a touch was told, the variance by which the bias may have walked
            while it was not followed, and its walk a sample, in those of a sample, (4,).
        bias: whitened, (6,).
        sums: running for each length, (6, 6); counts: of parts in them, (6,).
        scatter: Cholesky factor of S for each length, (6, 6, 6); moments: what S is made from, (6, 6, 6).
    """

    whiten: Array
    thresholds: Array
    released: float
    gain: float
    trusted: float
    state: Array
    bias: Array
    sums: Array
    counts: Array
    scatter: Array
    moments: Array

    @classmethod
    def fresh(
        cls, whiten: Array, thresholds: Array, released: float, gain: float, trusted: float, walk: float
    ) -> "Memory":
        """Of a probe that is free."""
        lengths = len(LENGTHS)
        eye = np.tile(np.eye(6), (lengths, 1, 1))
        return cls(whiten, thresholds, released, gain, trusted, np.array([0.0, 0.0, 0.0, walk]), np.zeros(6),
                   np.zeros((lengths, 6)), np.zeros(lengths), eye.copy(), eye.copy())  # fmt: skip


@inner
def square(z, factor):
    """zᵀ S⁻¹ z by forward substitution with S's Cholesky factor."""
    y0 = z[0] / factor[0, 0]
    y1 = (z[1] - factor[1, 0] * y0) / factor[1, 1]
    y2 = (z[2] - factor[2, 0] * y0 - factor[2, 1] * y1) / factor[2, 2]
    y3 = (z[3] - factor[3, 0] * y0 - factor[3, 1] * y1 - factor[3, 2] * y2) / factor[3, 3]
    y4 = (z[4] - factor[4, 0] * y0 - factor[4, 1] * y1 - factor[4, 2] * y2 - factor[4, 3] * y3) / factor[4, 4]
    y5 = (
        z[5]
        - factor[5, 0] * y0
        - factor[5, 1] * y1
        - factor[5, 2] * y2
        - factor[5, 3] * y3
        - factor[5, 4] * y4
    ) / factor[5, 5]
    return y0 * y0 + y1 * y1 + y2 * y2 + y3 * y3 + y4 * y4 + y5 * y5


@inner
def learn(j, z, share, moments, scatter):
    """Let the covariance of means of length j forget a little and take in one more; factor it anew."""
    for a in range(6):
        for b in range(6):
            moments[j, a, b] += share * (z[a] * z[b] - moments[j, a, b])
    # Never less than the sensor's own noise: a quiet spell does not make the test nervous.
    for a in range(6):
        for b in range(a + 1):
            value = max(moments[j, a, b], 1.0) if a == b else moments[j, a, b]
            for q in range(b):
                value -= scatter[j, a, q] * scatter[j, b, q]
            if a == b:
                scatter[j, a, a] = np.sqrt(max(value, 0.5))
            else:
                scatter[j, a, b] = value / scatter[j, b, b]


@kernel
def advance(
    samples, whiten, thresholds, released, gain, trusted, state, bias, sums, counts, scatter, moments, codes
):
    """Take in samples (n, 6), one after another; codes (n,) are filled.

    Returns:
        What the last of them says.
    """
    lengths = thresholds.shape[0]
    white = np.empty(6)
    z = np.empty(6)
    said = FREE
    for i in range(samples.shape[0]):
        finite = True
        for a in range(6):
            white[a] = -bias[a]
            for b in range(a + 1):
                white[a] += whiten[a, b] * samples[i, b]
            finite = finite and np.isfinite(white[a])
        if not finite:
            codes[i] = said = INVALID
            continue
        touching = state[STATE_NOW] == CONTACT
        said = CONTACT if touching else FREE
        state[DOUBT] += state[WALK]
        for a in range(6):
            sums[0, a] += white[a]
        counts[0] += 1.0
        j, n = 0, 1.0
        while j < lengths and counts[j] >= (1.0 if j == 0 else RATIO):
            # The bias walks unseen, while touched and from one step of following it to the next: a free mean may lie
            # off by that, at the end of a touch too.
            root = np.sqrt(n * (1.0 + n * state[DOUBT]))
            for a in range(6):
                z[a] = sums[j, a] / root
            far = square(z, scatter[j])
            if touching:
                if j == int(state[DETECTED_BY]) and far < released:
                    state[STATE_NOW], said = FREE, LOST
            elif far > thresholds[j] and said == FREE:
                state[STATE_NOW], state[DETECTED_BY], said = CONTACT, j, CONTACT
            elif said == FREE:
                learn(j, z, 1.0 / trusted, moments, scatter)
                if j == lengths - 1:
                    doubt = n * state[DOUBT] + gain / (1.0 - gain)  # over a mean's noise
                    for a in range(6):
                        bias[a] += doubt / (doubt + 1.0) * sums[j, a] / n
                    state[DOUBT] /= doubt + 1.0
            if j + 1 < lengths:
                for a in range(6):
                    sums[j + 1, a] += sums[j, a]
                counts[j + 1] += 1.0
            for a in range(6):
                sums[j, a] = 0.0
            counts[j] = 0.0
            j, n = j + 1, n * RATIO
        if said == LOST or (said == CONTACT and not touching):
            for j in range(lengths):  # what lies before the change says nothing of after it
                counts[j] = 0.0
                for a in range(6):
                    sums[j, a] = 0.0
        codes[i] = said
    return said
