"""The spatio-temporal encoder: what it must be blind to, and what it computes once."""

import pytest
import torch

from samarl.encoders import Frames, SpatioTemporalEncoder
from samarl.encoders.encoder import NEAR_NOW, NEAR_SOON
from samarl.encoders.spatio_temporal import Pool, nearness

EGO, OTHER, HISTORY = 5, 10, 4


def encoder(history: int = HISTORY) -> SpatioTemporalEncoder:
    torch.manual_seed(0)
    return SpatioTemporalEncoder(EGO, OTHER, width=16, heads=2, history=history, out=12)


def frames(b: int = 6, t: int = 11, m: int = 5, n: int = 3) -> Frames:
    torch.manual_seed(1)
    known, others_known = torch.rand(b, t, m) < 0.6, torch.rand(b, t, n - 1) < 0.6
    return Frames(
        torch.randn(b, t, EGO),
        torch.randn(b, t, m, OTHER) * known.unsqueeze(-1),
        known,
        torch.randn(b, t, n - 1, OTHER) * others_known.unsqueeze(-1),
        others_known,
    )


def test_whole_sequences_give_what_single_windows_give() -> None:
    model, data = encoder(), frames()
    begins = torch.rand(6, 11) < 0.2  # episodes of all lengths within the sequences
    whole = model(data, begins)
    assert whole.shape == (6, 11 - HISTORY + 1, 12)
    for t in range(whole.shape[1]):
        window = slice(t, t + HISTORY)
        one = model(data.at(window), begins[:, window])
        torch.testing.assert_close(one[:, 0], whole[:, t], atol=1e-5, rtol=0)


def test_frame_by_frame_it_gives_what_the_whole_sequence_gives() -> None:
    model, data = encoder(), frames(t=20)
    begins = torch.rand(6, 20) < 0.15
    begins[:, 0] = True
    whole = model(data, begins)
    windows = model.windows(data.at(slice(0, 1)))
    for t in range(20):
        y, windows = model.step(data.at(slice(t, t + 1)), begins[:, t], windows)
        if t >= HISTORY - 1:
            torch.testing.assert_close(y, whole[:, t - HISTORY + 1], atol=1e-5, rtol=0)


def test_history_counts_within_an_episode_and_not_across_its_beginning() -> None:
    model, data = encoder(), frames(t=HISTORY)
    never, now = torch.zeros(6, HISTORY, dtype=torch.bool), torch.zeros(6, HISTORY)
    now[:, -1] = 1
    other = Frames(*(torch.cat([x[:, :-1].flip(0), x[:, -1:]], 1) for x in data))
    assert not torch.allclose(model(data, never), model(other, never), atol=1e-4)
    torch.testing.assert_close(model(data, now.bool()), model(other, now.bool()))


def test_it_is_finite_with_nobody_in_view_and_with_nobody_at_all() -> None:
    model = encoder()
    for m, n in ((5, 3), (0, 3), (5, 1), (0, 1)):
        data = frames(m=m, n=n)
        blind = data._replace(
            humans=torch.zeros_like(data.humans),
            humans_known=torch.zeros_like(data.humans_known),
            robots=torch.zeros_like(data.robots),
            robots_known=torch.zeros_like(data.robots_known),
        )
        y = model(blind, torch.zeros(6, 11, dtype=torch.bool))
        y.sum().backward()
        assert torch.isfinite(y).all()
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        assert all(torch.isfinite(gradient).all() for gradient in gradients)


def test_the_slots_of_people_and_robots_have_no_order() -> None:
    model, data = encoder(), frames()
    begins = torch.zeros(6, 11, dtype=torch.bool)
    people, robots = torch.randperm(5), torch.tensor([1, 0])
    mixed = Frames(
        data.ego,
        data.humans[:, :, people],
        data.humans_known[:, :, people],
        data.robots[:, :, robots],
        data.robots_known[:, :, robots],
    )
    torch.testing.assert_close(model(data, begins), model(mixed, begins), atol=1e-5, rtol=0)


def test_what_is_masked_changes_nothing() -> None:
    model, data = encoder(), frames()
    begins = torch.zeros(6, 11, dtype=torch.bool)
    noise = torch.randn_like(data.humans) * ~data.humans_known.unsqueeze(-1)
    y = model(data, begins)
    torch.testing.assert_close(y, model(data._replace(humans=data.humans + noise), begins))
    seen = data.humans + torch.randn_like(data.humans) * data.humans_known.unsqueeze(-1)
    assert not torch.allclose(y, model(data._replace(humans=seen), begins), atol=1e-3)


def test_the_near_weigh_more_in_the_graph() -> None:
    spatial = encoder(history=1).humans.spatial
    tokens = torch.randn(1, 3, 16, requires_grad=True)
    others = torch.zeros(1, 3, OTHER)
    others[0, :, 0] = torch.tensor([0.0, 0.1, 2.0])  # units of 5 m
    with torch.no_grad():  # the gate shut to attention: only the graph convolution is left
        spatial.gate.weight.zero_()
        spatial.gate.bias.fill_(-50.0)
        spatial.norm.weight.fill_(1.0)
    spatial(tokens, others, torch.ones(1, 3, dtype=torch.bool))[0, 0].sum().backward()
    assert tokens.grad is not None
    near, far = tokens.grad[0, 1].norm(), tokens.grad[0, 2].norm()
    assert near > 10 * far


def test_attention_begins_with_the_near_and_with_those_who_will_be_near() -> None:
    gap = torch.tensor([0.5, 1.5, 4.0])
    others = torch.zeros(1, 3, OTHER)
    others[0, :, NEAR_NOW] = torch.exp(-2 * gap)
    others[0, :, NEAR_SOON] = torch.exp(-2 * gap.flip(0))
    known = torch.tensor([[True, True, False]])
    score = nearness(others, known, heads=3)
    assert score[0, :, 0].tolist() == pytest.approx([-0.5, -4.0, -0.5])  # now, soon, now
    assert score[0, :, 1].tolist() == pytest.approx([-1.5] * 3)
    assert (score[0, :, 2] < -1e8).all()
    pool = Pool(16, heads=1)
    with torch.no_grad():
        pool.query.weight.zero_()  # nothing learned yet: 1 per metre, and 0 for nobody
        pool.query.bias.zero_()
    shares = pool.shares(torch.zeros(1, 16), torch.randn(1, 3, 16), score[:, :1])
    weights = torch.exp(torch.tensor([-0.5, -1.5]))
    torch.testing.assert_close(shares[0, :2], weights / (1 + weights.sum()))
    assert shares[0, 2] == 0
