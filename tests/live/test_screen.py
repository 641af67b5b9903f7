"""Spikes, stuck channels and a sway: no false touch, no false position, and one event. The truth is injected."""

import math

import numpy as np
import pytest

from probedesign.live.blocks import Block
from probedesign.live.processing.chain import Chain, ProcessingOptions
from probedesign.live.processing.tare import TareWindow
from probedesign.live.run import estimate_stream
from probedesign.live.sources.source import open_source
from probedesign.rod.rod import natural_frequency
from tests.live.peers import box

SECONDS = 12.0


def readings(estimator, rate, averaged, seed=3):
    """Return times and quantised readings of a free probe, single samples or means."""
    model, rng = estimator.model, np.random.default_rng(seed)
    std = model.noise.std * (1.0 if averaged else math.sqrt(model.averaging_samples))
    time = np.arange(int(SECONDS * rate)) / rate
    free = model.to_sensor(estimator.free().wrench_base, model.gravity_base)
    return time, np.rint((free + std * rng.standard_normal((len(time), 6))) / (0.2 * std)) * 0.2 * std, std


def run(estimator, time, wrench):
    chain, lines = None, []
    chain = Chain(estimator, ProcessingOptions(TareWindow(0.0, 1.0), None), None, lines.append)
    blocks = (slice(i, i + 100) for i in range(0, len(time), 100))
    unknown, gravity = np.full(100, math.nan), estimator.model.gravity_base
    updates = [u for b in blocks for u in chain.process(Block(time[b], wrench[b], gravity, unknown[: len(time[b])]))]
    return [*updates, *chain.finish()], chain, lines


@pytest.mark.parametrize(
    ("rate", "width", "size"),
    [(7000.0, 1, 10.0), (7000.0, 5, 300.0), (1000.0, 1, 300.0), (1000.0, 3, 10.0), (100.0, 1, 10.0), (100.0, 2, 300.0),
     (20.0, 1, 10.0), (20.0, 1, 300.0)],
)  # fmt: skip
def test_spikes_are_no_touches(rate, width, size, estimator):
    """In up to six channels at once, of so many standard deviations, once in 0.7 s; both signs."""
    time, wrench, std = readings(estimator, rate, averaged=rate < 500.0)
    rng = np.random.default_rng(7)
    for begin in np.arange(2.0, SECONDS - 0.5, 0.7):
        i, channels = int(begin * rate) + int(rng.integers(0, 36)) % 5, rng.permutation(6)[: rng.integers(1, 7)]
        wrench[i : i + width, channels] += size * std[channels] * rng.choice([-1.0, 1.0], len(channels))
    updates, chain, lines = run(estimator, time, wrench)
    assert not chain.contacts and {u.estimate.result for u in updates} == {"no_contact"}
    assert 1 <= sum("spikes" in line for line in lines) <= 2


@pytest.mark.parametrize(
    ("channel", "rate", "within"),
    [(c, *((7000.0, 0.02), (1000.0, 0.1), (100.0, 0.5))[(c + k) % 3]) for c in range(6) for k in (0, 1)],
)
def test_a_stuck_channel_is_noticed_before_it_matters(channel, rate, within, estimator):
    """Noise of five steps of the resolution; the probe is touched 0.5 s after the channel has stuck at a value that it
    had while it was free."""
    time, wrench, _ = readings(estimator, rate, averaged=rate < 500.0)
    model, touched = estimator.model, time >= 5.5
    touch = model.to_sensor(np.array([0.02, 0.0, 0.0, 0.0, 2e-3, 0.0]), np.zeros(3)) - model.to_sensor(
        np.zeros(6), np.zeros(3)
    )
    wrench[touched] += touch
    wrench[time >= 5.0, channel] = wrench[np.argmax(time >= 5.0), channel]
    updates, chain, _ = run(estimator, time, wrench)
    after = [u for u in updates if u.reading.time > 5.0 + within]
    assert after and all("has not changed" in u.reading.fault for u in after)
    assert not chain.contacts and not any(u.estimate.ok for u in updates)


@pytest.mark.parametrize("std_steps", [0.3, 0.5])
def test_a_coarse_resolution_is_no_stuck_channel(std_steps, estimator):
    """Noise below a step of the resolution repeats values; in the middle of a step most of all."""
    rate, model = 1000.0, estimator.model
    time, rng = np.arange(int(60.0 * rate)) / rate, np.random.default_rng(2)
    step = model.noise.std * math.sqrt(model.averaging_samples) / std_steps
    free = np.rint(model.to_sensor(estimator.free().wrench_base, model.gravity_base) / step) * step
    wrench = np.rint((free + std_steps * step * rng.standard_normal((len(time), 6))) / step) * step
    updates, _, _ = run(estimator, time, wrench)
    assert not any("changed" in u.reading.fault for u in updates)


def test_a_sway_is_one_touch(estimator):
    """A free probe sways by 2 mN for nine seconds, sixty periods, each of which crosses the threshold twice."""
    time, wrench, _ = readings(estimator, 1000.0, averaged=False)
    model = estimator.model
    force = 2e-3 * np.sin(2.0 * np.pi * natural_frequency(model.rod) * time) * (time > 3.0)
    added = force[:, None] * np.array([1.0, 0.0, 0.0, 0.0, 0.55 * model.rod.length, 0.0])
    updates, chain, lines = run(estimator, time, wrench + model.to_sensor(added, np.zeros(3)))
    assert len(chain.contacts) == 1 and not chain.contacts[0].settled
    assert sum(line.startswith("touch") for line in lines) <= 1
    assert not any(u.estimate.ok for u in updates)


def test_spikes_and_a_stuck_channel_at_the_wire(estimator):
    """The box sends single samples of 200 standard deviations, then repeats one channel."""
    model, lines, updates = estimator.model, [], []
    still = model.to_sensor(estimator.free().wrench_base, model.gravity_base)
    with box(estimator, load=still) as peer:
        read, spiked, kept = peer._transducer.read, [0, 0], []

        def disturbed(time, configuration):
            counts, status = read(time, configuration)
            if 20 <= len(updates) < 200:
                for i in range(len(counts)):
                    spiked[0] += 1
                    if spiked[0] % 500 == 0:
                        counts[i, :3] += 200
                        spiked[1] += 1
            elif len(updates) >= 200:
                kept.append(counts[0, 2])
                counts[:, 2] = kept[0]
            return counts, status

        peer._transducer.read = disturbed
        options = ProcessingOptions(TareWindow(0.0, 0.5), 36)
        stream = estimate_stream(estimator, open_source(peer.source, model, lines.append), options, lines.append)
        for update in stream:
            updates.append(update)
            if "Fz has not changed" in update.reading.fault or len(updates) > 1000:
                stream.close()
                break
    assert spiked[1] > 5 and "Fz has not changed" in updates[-1].reading.fault
    assert {u.estimate.result for u in updates[:-1]} == {"no_contact"} and not updates[-1].contacts
