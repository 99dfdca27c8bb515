"""Encoders: what they must be blind to, and that they see over time what they see at once."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from mrsan import Observation
from samarl.encoders import ENCODERS, Encoder
from samarl.encoders.encoder import EncoderState
from samarl.encoders.recurrent_graph import RecurrentUnit
from samarl.encoders.transformer_layers import Pool, nearness
from samarl.observations.features import (
    AGENT_SIZES,
    NEAR_NOW,
    NEAR_SOON,
    NETWORK_EGO_FEATURES,
    NETWORK_OTHER_FEATURES,
)
from samarl.observations.frames import Frames, slice_time
from tests.learning import ENCODERS as NUMBERS
from tests.scenes import blind, changed

EGO, OTHER = NETWORK_EGO_FEATURES, NETWORK_OTHER_FEATURES
ABLATIONS = ("graph=", "cross_modal=", "one_block=True")
WALLS = ("spatio_temporal walls", "set_pool walls")  # that read walls and a lidar as well
WALL_SIZES = replace(
    AGENT_SIZES, entities={**AGENT_SIZES.entities, "walls": 7}, sensors={"lidar": (24,)}
)
every = pytest.mark.parametrize(
    "name", [*ENCODERS, *(f"spatio_temporal {change}" for change in ABLATIONS), *WALLS]
)


def encoder(name: str, **changes: Any) -> Any:
    """An encoder; its name may have a change of one of its flags behind it."""
    torch.manual_seed(0)
    name, _, change = name.partition(" ")
    if change and change != "walls":
        flag, _, on = change.partition("=")
        changes[flag] = bool(on)
    config = ENCODERS.config({"name": name, **NUMBERS[name], **changes})
    return ENCODERS[name].cls(config, WALL_SIZES if change == "walls" else AGENT_SIZES)


def frames(b: int = 6, t: int = 11, m: int = 5, n: int = 3) -> Frames:
    torch.manual_seed(1)
    known, others_known = torch.rand(b, t, m) < 0.6, torch.rand(b, t, n - 1) < 0.6
    walls_known = torch.rand(b, t, 4) < 0.6
    return Observation.from_arrays(
        {
            "ego": torch.randn(b, t, EGO),
            "humans": torch.randn(b, t, m, OTHER) * known.unsqueeze(-1),
            "humans_known": known,
            "robots": torch.randn(b, t, n - 1, OTHER) * others_known.unsqueeze(-1),
            "robots_known": others_known,
            "walls": torch.rand(b, t, 4, 7) * walls_known.unsqueeze(-1),
            "walls_known": walls_known,
            "lidar": torch.rand(b, t, 24),
        }
    )


def start(model: Encoder, data: Frames) -> EncoderState:
    return model.initial_state(slice_time(data, slice(0, 1)))


def seen(model: Encoder, data: Frames, begins: Tensor, samples: Tensor | None = None) -> Tensor:
    """Y of every frame after the history [B T, F], or of some; each robot asks for itself."""
    scene = model.observe(data, begins, start(model, data), samples)
    query = data.ego[:, model.history :].flatten(0, 1)
    return model.read(scene, query if samples is None else query[samples])


def some_begin(b: int = 6, t: int = 11) -> Tensor:
    begins = torch.rand(b, t, generator=torch.Generator().manual_seed(2)) < 0.2
    begins[:, 0] = True
    return begins


@every
def test_frame_by_frame_it_gives_what_the_whole_sequence_gives(name: str) -> None:
    model, data, begins = encoder(name), frames(t=20), some_begin(t=20)
    whole = seen(model, data, begins).view(6, 20 - model.history, -1)
    state = start(model, data)
    for t in range(20):
        now = slice_time(data, slice(t, t + 1))
        y = model.read(model.step(now, begins[:, t], state), now.ego[:, 0])
        if t >= model.history:
            torch.testing.assert_close(y, whole[:, t - model.history], atol=1e-5, rtol=0)


@every
def test_some_robots_alone_step_as_in_a_batch(name: str) -> None:
    model, data, begins = encoder(name), frames(), some_begin()
    rows = torch.tensor([4, 1])
    together, alone = start(model, data), start(model, data.select(rows))
    for t in range(11):
        now = slice_time(data, slice(t, t + 1))
        batch = model.read(model.step(now, begins[:, t], together), now.ego[:, 0])
        scene = model.step(now.select(rows), begins[rows, t], alone)
        y = model.read(scene, now.ego[rows, 0])
        torch.testing.assert_close(y, batch[rows], atol=1e-5, rtol=0)


@every
def test_it_resumes_from_its_memory_and_the_last_frames(name: str) -> None:
    model, data, begins = encoder(name), frames(t=16), some_begin(t=16)
    state = start(model, data)
    for t in range(12):
        model.step(slice_time(data, slice(t, t + 1)), begins[:, t], state)
    resumed = start(model, data)
    for key, value in model.memory(state).items():
        resumed[key] = value.clone()
    last = slice(12 - model.history, 12)
    model.resume(slice_time(data, last), begins[:, last], resumed, torch.arange(6))
    for t in range(12, 16):
        now = slice_time(data, slice(t, t + 1))
        one, other = (
            model.read(model.step(now, begins[:, t], s), now.ego[:, 0]) for s in (state, resumed)
        )
        torch.testing.assert_close(one, other, atol=1e-5, rtol=0)


@every
def test_some_samples_are_what_they_are_among_all(name: str) -> None:
    model, data, begins = encoder(name), frames(), some_begin()
    samples = torch.tensor([17, 3, 3, 40])
    whole = seen(model, data, begins)
    torch.testing.assert_close(
        seen(model, data, begins, samples), whole[samples], atol=1e-5, rtol=0
    )


def test_history_counts_within_an_episode_and_not_across_its_beginning() -> None:
    model = encoder("spatio_temporal")
    data = frames(t=model.history + 1)
    never = torch.zeros(6, model.history + 1, dtype=torch.bool)
    now = never.clone()
    now[:, -1] = True
    other = data.apply(lambda x: torch.cat([x[:, :-1].flip(0), x[:, -1:]], 1))
    assert not torch.allclose(seen(model, data, never), seen(model, other, never), atol=1e-4)
    torch.testing.assert_close(seen(model, data, now), seen(model, other, now))


@every
def test_it_is_finite_with_nobody_in_view_and_with_nobody_at_all(name: str) -> None:
    model = encoder(name)
    for m, n in ((5, 3), (0, 3), (5, 1), (0, 1)):
        data = frames(m=m, n=n)
        empty = changed(
            data,
            humans=torch.zeros_like(data.humans),
            humans_known=torch.zeros_like(data.humans_known),
            robots=torch.zeros_like(data.robots),
            robots_known=torch.zeros_like(data.robots_known),
        )
        y = seen(model, empty, some_begin())
        y.sum().backward()
        assert torch.isfinite(y).all()
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        assert all(torch.isfinite(gradient).all() for gradient in gradients)


@every
def test_the_slots_of_people_and_robots_have_no_order(name: str) -> None:
    model, data, begins = encoder(name), frames(), some_begin()
    people, robots = torch.randperm(5), torch.tensor([1, 0])
    mixed = changed(
        data,
        humans=data.humans[:, :, people],
        humans_known=data.humans_known[:, :, people],
        robots=data.robots[:, :, robots],
        robots_known=data.robots_known[:, :, robots],
    )
    torch.testing.assert_close(
        seen(model, data, begins), seen(model, mixed, begins), atol=1e-5, rtol=0
    )


@every
def test_what_is_not_known_changes_no_bit(name: str) -> None:
    model, data, begins = encoder(name), frames(), some_begin()
    y = seen(model, data, begins)
    noise = torch.randn_like
    for size in (1.0, 1e6):
        garbage = changed(
            data,
            humans=data.humans + size * noise(data.humans) * ~data.humans_known[..., None],
            robots=data.robots + size * noise(data.robots) * ~data.robots_known[..., None],
        )
        assert torch.equal(y, seen(model, garbage, begins))
    known = data.humans + torch.randn_like(data.humans) * data.humans_known.unsqueeze(-1)
    assert not torch.allclose(y, seen(model, changed(data, humans=known), begins), atol=1e-3)


def test_attention_begins_with_the_near_and_with_those_who_will_be_near() -> None:
    gap = torch.tensor([0.5, 1.5, 4.0])
    others = torch.zeros(1, 3, OTHER)
    others[0, :, NEAR_NOW] = torch.exp(-2 * gap)
    others[0, :, NEAR_SOON] = torch.exp(-2 * gap.flip(0))
    known = torch.tensor([[True, True, False]])
    score = nearness(others, known, heads=3)
    assert score[0, 0].tolist() == pytest.approx([-0.5, -4.0, -0.5])  # now, soon, now
    assert score[0, 1].tolist() == pytest.approx([-1.5] * 3)
    assert (score[0, 2] < -1e8).all()
    pool = Pool(16, heads=1)
    with torch.no_grad():
        pool.query.weight.zero_()  # nothing learned yet: 1 per metre, and 0 for nobody
        pool.query.bias.zero_()
    shares = pool.weights(torch.zeros(1, 16), torch.randn(1, 3, 16), score[..., :1])
    weights = torch.exp(torch.tensor([-0.5, -1.5]))
    torch.testing.assert_close(shares[0, :2], weights / (1 + weights.sum()))
    assert shares[0, 2] == 0


def test_a_recurrent_unit_is_torchs_on_the_frames_that_are_known() -> None:
    unit, cell = RecurrentUnit(7, 8), torch.nn.GRUCell(7, 8)
    data, begins = torch.randn(20, 6, 5, 7), some_begin(t=20).T
    known, before = torch.rand(20, 6, 5) < 0.6, torch.randn(6, 5, 8)
    begins[0, :3] = False  # these go on from what was before
    with torch.no_grad():
        for ours, theirs in ((unit.of_input, "ih"), (unit.of_hidden, "hh")):
            for name in ("weight", "bias"):  # ours: how much is taken in, not what stays
                reset, stays, new = getattr(cell, f"{name}_{theirs}").chunk(3)
                getattr(ours, name).copy_(torch.cat([-stays, reset, new]))
        states = unit(data, known, begins, before)
        for b in range(6):
            for m in range(5):
                hidden = before[b, m]
                for t in range(20):
                    if begins[t, b]:
                        hidden = torch.zeros(8)
                    if known[t, b, m]:
                        hidden = cell(data[t, b, m], hidden)
                    torch.testing.assert_close(states[t, b, m], hidden, atol=1e-5, rtol=0)


def test_social_attention_by_hand() -> None:
    """Encounters one by one, in plain sums; and who is alone hears of nobody."""
    model, data = encoder("social_attention"), frames(t=1)
    scene = model.observe(data, torch.ones(6, 1, dtype=torch.bool), {})
    query = torch.randn(6, EGO)
    robots, humans = model.attention(scene, query)
    for p in range(6):
        both = torch.cat([data.ego[p, 0], query[p]])
        rows = [
            (model.robots, data.robots[p, 0, j]) for j in range(2) if data.robots_known[p, 0, j]
        ]
        rows += [
            (model.humans, data.humans[p, 0, j]) for j in range(5) if data.humans_known[p, 0, j]
        ]
        encounters = [model.embed(first(other) + model.own(both)) for first, other in rows]
        mean = sum(encounters) / len(encounters)
        weights = [model.score(model.of_one(e) + model.of_all(mean)).exp() for e in encounters]
        weighted_sum = sum(w * model.tells(e) for w, e in zip(weights, encounters, strict=True))
        expected = torch.cat([query[p], weighted_sum / sum(weights)])
        torch.testing.assert_close(model.read(scene, query)[p], expected)
        share = torch.cat([robots[p][data.robots_known[p, 0]], humans[p][data.humans_known[p, 0]]])
        torch.testing.assert_close(share, torch.cat(weights) / sum(weights))
    alone = blind(data)
    y = model.read(model.observe(alone, torch.ones(6, 1, dtype=torch.bool), {}), query)
    assert torch.equal(y, torch.cat([query, torch.zeros(6, 8)], 1))


@pytest.mark.parametrize("name", WALLS)
@pytest.mark.parametrize("part", ["walls", "lidar"])
def test_it_reads_walls_and_the_lidar(name: str, part: str) -> None:
    data = frames()
    other = data.arrays("known")
    other[part] = torch.rand_like(other[part]) * (
        other["walls_known"].unsqueeze(-1) if part == "walls" else 1.0
    )
    changed_data = Observation.from_arrays(other)
    model = encoder(name)
    before, after = (seen(model, one, some_begin()) for one in (data, changed_data))
    assert not torch.equal(before, after)
