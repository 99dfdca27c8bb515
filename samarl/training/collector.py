"""Collect rollouts from the worlds of one stage of a curriculum."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor
from torch.utils._pytree import tree_leaves, tree_map

from mrsan import ActionError, Episodes, Observation, Split, World
from mrsan.features import GOAL
from mrsan.metrics import episodes_of
from samarl.agents.agent import Agent, checked_act
from samarl.agents.planners.right_of_way import RightOfWay
from samarl.observations.features import speed_of, state_features, state_sizes, true_state
from samarl.observations.frames import Frames, concatenate, slice_time
from samarl.observations.route import next_point
from samarl.observations.tracker import Tracker
from samarl.planning.shield import Shield, apply_shield
from samarl.policies.policy import LOCAL, Decision, Policy, PolicyState
from samarl.policies.stochastic import StochasticPolicy
from samarl.reward_shaping import RewardShaping, level_rewards
from samarl.rollout import Rollout, level_key
from samarl.training.curriculum import CurriculumStage
from samarl.training.restarts import SnapshotBuffer, WarmStartCrowd

RESTART_STEPS = 16  # a world restarts at most so many steps before a collision
STANDING = 0.5  # m; a robot stands while it stays so close to a place, however it moves there
UNSAFE = 1e-4  # smallest change by the shield that counts as a correction
SAVED = (  # attributes of a collector that are saved as they are
    "observation",
    "directed",
    "state",
    "age",
    "not_restarted",
    "standstill",
    "stand",
    "is_init",
    "frames",
    "begins",
    "decision",
    "active",
    "teacher_action",
    "encoder_before",
)


class RolloutCollector:
    """Collect T steps of E worlds at a time, with exploration noise.

    It fills the same TensorDict as TorchRL's `Collector` over `TorchRLEnv`, but faster, and can
    restart worlds shortly before a collision.
    """

    def __init__(
        self,
        stage: CurriculumStage,
        policy: Policy,
        steps: int,
        first: int,
        uses_global_state: bool = False,
        uses_shield_targets: bool = False,
        teacher: Agent | None = None,
        guide: RightOfWay | None = None,
    ) -> None:
        """Start the training cases `first`, `first + 1`, ... in the worlds of `stage`.

        Args:
            stage: scenario, worlds, and how episodes begin.
            policy: decides and explores.
            steps: T.
            first: the first case number within the training split; 2 E of them are used.
            uses_global_state: store the global state too, for central critics.
            uses_shield_targets: store the actions of the safety shield too.
            teacher: store its actions too, in `stage.teacher_share` of the worlds.
            guide: sends robots to their targets; None: to their goals.
        """
        self.stage, self.policy, self.steps = stage, policy, steps
        self.shaping, self.imitates = RewardShaping(), teacher is not None
        self.uses_global_state = uses_global_state
        self.shield = Shield() if uses_shield_targets else None
        self.teacher = teacher
        self.teacher_worlds = slice(max(round(stage.teacher_share * stage.worlds), 1))
        if teacher is not None:
            teacher.reset(np.ones(stage.worlds, np.bool_)[self.teacher_worlds])
        self.guide = guide
        if guide is not None:
            guide.reset(np.ones(stage.worlds, np.bool_))
        scenario, worlds = stage.scenario, stage.worlds
        self.scenario = stage.driver_scenario
        self.world = World(scenario, worlds)
        self.state = policy.initial_state(worlds, self.scenario)
        cases = np.array([Split.training.case(first + e) for e in range(worlds)])
        self.observation = self.world.reset(cases)
        self.directed = self.observation  # what the policy is shown of it
        self.is_init = np.ones(worlds, np.bool_)
        drives_round = scenario.fov_degrees < policy.config.perimeter_below_fov
        self.crowd = None
        if stage.midway_start_probability > 0.0 and drives_round:
            self.crowd = WarmStartCrowd(scenario, worlds, first + worlds)
        self.snapshots = SnapshotBuffer(RESTART_STEPS)
        self.age = np.zeros(worlds, np.int64)  # steps since the episode began or was restarted
        self.not_restarted = np.ones(worlds, np.bool_)  # episodes since their last reset
        self.standstill = np.zeros((worlds, scenario.robots), np.int64)  # steps at `stand`
        self.stand = self.world.state.robot_position.copy()  # [E, N, 2] where each robot stands, m
        # Columns of the frame buffer: history for the encoder and restarts, then steps 0 to T.
        self.past = policy.history + (RESTART_STEPS if self._restarts else 0)
        columns = self.past + steps + 1
        self.frames = policy.empty_frames(self.scenario, worlds * scenario.robots).apply(
            lambda tensor: tensor.repeat(1, columns, *[1] * (tensor.dim() - 2))
        )
        self.begins = torch.ones(self.frames.ego.shape[:2], dtype=torch.bool, device=policy.device)
        self.decision: Decision  # for the next step
        # For the next step, 0 where no teacher says what it would do:
        self.teacher_action = torch.zeros(worlds, scenario.robots, scenario.action_size)
        self.encoder_before: Any = None  # state of the encoders before it
        for _ in range(RESTART_STEPS if self._restarts else 0):
            self.snapshots.append(self.world, self._memory())
        self._decide(steps)

    @property
    def _restarts(self) -> bool:
        return self.stage.failure_restart_probability > 0.0

    @torch.no_grad()
    def collect(self, shaping: RewardShaping | None = None, imitates: bool = True) -> Rollout:
        """Collect T more steps of every world.

        Args:
            shaping: of the rewards; None: none.
            imitates: store the teacher's actions. Once it is False, the teacher does not act again.
        """
        self.shaping, self.imitates = shaping or RewardShaping(), imitates
        if not imitates:
            self.teacher = None
        policy, world, t, h = self.policy, self.world, self.steps, self.policy.history
        for tensor in (*tree_leaves(self.frames), self.begins):  # step T becomes step 0
            tensor[:, : self.past + 1] = tensor[:, t : t + self.past + 1].clone()
        recent = slice(self.past + 1 - h, self.past + 1)  # encoded again with the new weights
        every = torch.arange(len(self.begins), device=policy.device)
        if isinstance(policy, StochasticPolicy):
            policy.resume(
                slice_time(self.frames, recent), self.begins[:, recent], self.state, every
            )
        encoder_before = self.encoder_before
        mask = torch.ones(world.worlds, t + 1, 1, dtype=torch.bool)
        closed: list[tuple[NDArray, Tensor, Frames, Tensor]] = []
        columns, states = [], []
        episodes: list[Episodes] = []
        for step in range(t):
            states.append(self._true_state())
            columns.append(self._decision_column() | self._step(episodes))
            back = self._begin(columns[-1]["next", "done"][:, 0].numpy())
            if back.any():
                worlds = np.flatnonzero(back)
                rows = self._rows_of(worlds)
                until = mask[worlds].clone()
                until[:, step + 1 :] = False
                closed.append((worlds, until, *self._rollout_frames(rows)))
                mask[worlds, : step + 1] = False
                self._restart(worlds, back[worlds], self.past + step + 1)
            self._decide(step + 1)
        outcome = {key: torch.zeros_like(x) for key, x in columns[-1].items() if key[0] == "next"}
        columns.append(self._decision_column() | outcome)
        states.append(self._true_state())
        return self._rollout(columns, states, mask, closed, encoder_before, episodes)

    def _decide(self, step: int) -> None:
        """Let the policy decide before step 1 to T of the rollout."""
        if self._restarts:
            self.snapshots.append(self.world, self._memory())
        if step == self.steps:
            self.encoder_before = tree_map(torch.clone, self._policy_memory().get("encoder", ()))
        scenario = self.scenario
        self.active = ~self.world.state.arrived
        self.directed = self.observation
        if self.guide is not None:
            if self.is_init.any():
                self.guide.reset(self.is_init)
            self.guide.decide(self.observation)
            self.directed = self.guide.direct()
            self.world.tell(self.guide.macro_actions())
        self.decision = self.policy.act(
            self.directed,
            self.state,
            self.is_init,
            scenario,
            self.stage.noise_correlation,
            self.active,
        )
        if self.teacher is not None:
            observation = self.observation.of_worlds(self.teacher_worlds)
            action = checked_act(self.teacher, observation, self.stage.scenario, "teacher")
            self.teacher_action[self.teacher_worlds] = torch.from_numpy(action)
        column = self.past + step
        for buffer, tensor in zip(
            tree_leaves(self.frames), tree_leaves(self.decision.features), strict=True
        ):
            buffer[:, column] = tensor[:, 0]
        begins = torch.from_numpy(np.repeat(self.is_init, scenario.robots))
        self.begins[:, column] = begins.to(self.begins.device)

    def _true_state(self) -> Observation | None:
        """Return the true state, with the waypoints that were just decided, for central critics."""
        if not self.uses_global_state:
            return None
        waypoints = self.policy.team_waypoints(self.state, self.observation.ego)
        state = true_state(self.world, waypoints)
        if self.guide is None:
            return state
        ego = state.ego.copy()
        ego[..., GOAL] = self.directed.ego[..., GOAL]
        return state._replace(
            ego=ego, sensors={**state.sensors, "route": next_point(self.directed)}
        )

    def _decision_column(self) -> dict[Any, Tensor]:
        """Return what was decided for the next step, by the keys of `Rollout.steps`."""
        decision, step = self.decision, self.decision.step
        active = torch.from_numpy(self.active)
        column: dict[Any, Tensor] = {
            ("is_init",): torch.from_numpy(self.is_init[:, None].copy()),
            ("agents", "active_mask"): active,
            ("agents", "speed"): torch.from_numpy(speed_of(self.observation.ego)),
        }
        if step.previous_noise is not None:
            column["agents", "previous_noise"] = step.previous_noise
        if step.waypoint_features is not None:
            column["agents", "waypoint_features"] = step.waypoint_features
        if self.shield is not None:
            scenario, mean = self.stage.scenario, step.mean.clamp(-1.0, 1.0)
            tracker = Tracker(self.shield.track_time, scenario.time_step)
            nobody = np.zeros(len(active), np.bool_)
            tracks = tracker.update(self.observation, self.state["tracks"], nobody, 0.0)
            safe = torch.from_numpy(apply_shield(tracks, mean.numpy(), scenario, self.shield))
            column["agents", "safe_action"] = safe
            column["agents", "unsafe"] = ((safe - mean).abs().amax(-1) > UNSAFE) & active
        if self.imitates:
            has_teacher = np.zeros_like(self.active)
            if self.teacher is not None:
                has_teacher[self.teacher_worlds] = self.active[self.teacher_worlds]
            column["agents", "has_teacher"] = torch.from_numpy(has_teacher)
            column["agents", "teacher_action"] = self.teacher_action.clone()
        for name, level in decision.levels.items():
            key = level_key(name)
            column[(*key, "action")] = level.action
            column[(*key, "sample_log_prob")] = level.log_prob
            if name != LOCAL:
                column[(*key, "decision_mask")] = level.decided & active
        return column

    def _step(self, episodes: list[Episodes]) -> dict[Any, Tensor]:
        """Execute the decision; return its outcome by the keys of `Rollout.steps`."""
        world = self.world
        try:
            result = world.step(self.decision.action)
        except ActionError as error:
            raise ActionError(f"policy {type(self.policy).__name__}: {error}") from None
        stood_too_long = self._update_standstill()
        rewards = level_rewards(
            self.policy,
            self.shaping,
            self.stage.scenario,
            self.directed,
            result,
            self.state,
            self.active,
            np.float32(self.stage.standstill_penalty) * stood_too_long,
            is_directed=self.guide is not None,
        )
        ended = (result.terminated | result.truncated | stood_too_long.any(1))[:, None]
        failed = self._failed() | stood_too_long
        terminated = (failed | world.state.arrived.all(1, keepdims=True)) & ended
        if ended.any():
            counted = ended[:, 0] & self.not_restarted
            episodes.append(episodes_of(world.state, world.scenario, counted))
        self.age += 1
        self.observation = result.observation
        outcome: dict[Any, Tensor] = {
            ("next", "done"): torch.from_numpy(ended),
            ("next", "agents", "terminated"): torch.from_numpy(terminated),
        }
        for level, reward in rewards.items():
            outcome[("next", *level_key(level), "reward")] = torch.from_numpy(reward)
        return outcome

    def _update_standstill(self) -> NDArray[np.bool_]:
        """Update for how long each robot has stood; return which reached the limit, [E, N].

        A limit of the speed would be met by creeping.
        """
        stage, state = self.stage, self.world.state
        if stage.standstill_limit == 0.0:
            return np.zeros_like(self.active)
        stands = np.linalg.norm(state.robot_position - self.stand, axis=-1) < STANDING
        stands &= ~state.arrived
        if self.guide is not None:
            stands &= ~self.guide.waits
        self.stand[~stands] = state.robot_position[~stands]
        self.standstill = np.where(stands, self.standstill + 1, 0)
        return self.standstill >= max(stage.scenario.steps(stage.standstill_limit), 1)

    def _failed(self) -> NDArray[np.bool_]:
        """Return which robots ended an episode by a collision, [E, N]."""
        return (self.world.state.collision != 0) & self.stage.scenario.terminate_on_collision

    def _begin(self, ended: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Start the next episodes where one ended; return how many steps to go back, [E]."""
        world, e, stage = self.world, self.world.worlds, self.stage
        back = np.zeros(e, np.int64)
        self.is_init = ended.copy()
        if self.teacher is not None:
            self.teacher.reset(ended[self.teacher_worlds])
        if not ended.any():
            if self.crowd is not None:
                self.crowd.step()
            return back
        if self._restarts:
            collided = self._failed().any(1) & ended & (self.age > 1)
            restarts = collided & (torch.rand(e).numpy() < stage.failure_restart_probability)
            drawn = torch.randint(1, RESTART_STEPS + 1, (e,)).numpy()
            back[restarts] = np.minimum(drawn, self.age)[restarts]
        reset = ended & (back == 0)
        self.is_init = reset
        self.observation = world.reset(worlds=reset)
        if self.crowd is not None:
            self.crowd.step()
            midway = reset & (torch.rand(e).numpy() < stage.midway_start_probability)
            self.crowd.enter(world, midway, self.policy.config.round_radius)
            self.observation = world.observe()
        self.age[ended] = 0
        self.standstill[ended] = 0
        self.stand[ended] = world.state.robot_position[ended]
        self.not_restarted[ended] = reset[ended]
        return back

    def _restart(self, worlds: NDArray, back: NDArray, column: int) -> None:
        """Restart some worlds from earlier states; their history moves to before `column`."""
        steps = np.zeros(self.world.worlds, np.int64)
        steps[worlds] = back
        self.snapshots.restore(self.world, self._memory(), steps)
        self.observation = self.world.observe()
        h = self.policy.history
        for k in np.unique(back):
            rows = self._rows_of(worlds[back == k])
            for tensor in (*tree_leaves(self.frames), self.begins):
                tensor[rows, k:column] = tensor[rows, : column - k]
        rows = self._rows_of(worlds)
        recent = slice(column - h, column)
        if isinstance(self.policy, StochasticPolicy):
            last_frames, begins = (
                slice_time(self.frames, recent).select(rows),
                self.begins[rows, recent],
            )
            self.policy.resume(last_frames, begins, self.state, rows)

    def _rows_of(self, worlds: NDArray) -> Tensor:
        n = self.stage.scenario.robots
        rows = (worlds[:, None] * n + np.arange(n)).ravel()
        return torch.from_numpy(rows).to(self.policy.device)

    def _rollout_frames(self, rows: Tensor | slice) -> tuple[Frames, Tensor]:
        """Copy the frames of some rows for a rollout, and where episodes begin."""
        columns = slice(self.past - self.policy.history, None)
        frames = self.frames.apply(lambda tensor: tensor[rows, columns].clone())
        return frames, self.begins[rows, columns].clone()

    def _memory(self) -> list[Tensor]:
        """Return the state of the collector besides the worlds, [E, ...] each, not copied."""
        e, parts = self.world.worlds, []
        guide = () if self.guide is None else self.guide.memory
        for leaf in (self.is_init, *guide, *tree_leaves(self._policy_memory())):
            tensor = torch.from_numpy(leaf) if isinstance(leaf, np.ndarray) else leaf
            parts.append(tensor.view(e, len(tensor) // e, *tensor.shape[1:]))
        return parts

    def _policy_memory(self) -> PolicyState:
        """Return the memory that the policy cannot recompute from the last frames; not copied."""
        if isinstance(self.policy, StochasticPolicy):
            return self.policy.memory(self.state)
        return self.state

    def _rollout(
        self,
        columns: list[dict[Any, Tensor]],
        states: list[Observation | None],
        mask: Tensor,
        closed: list,
        encoder_before: Any,
        episodes: list[Episodes],
    ) -> Rollout:
        e, device = self.world.worlds, self.policy.device
        steps = TensorDict({}, [e, self.steps + 1])
        for key in columns[0]:
            steps[key] = torch.stack([column[key] for column in columns], 1)
        steps["mask"] = mask
        frames, begins = self._rollout_frames(slice(None))
        state = None
        if self.uses_global_state:
            state = self._state_frames([s for s in states if s is not None])
        if closed:
            worlds = torch.from_numpy(np.concatenate([part[0] for part in closed]))
            extra = steps[worlds]
            extra["mask"] = torch.cat([part[1] for part in closed])
            steps = torch.cat([steps, extra])
            frames = concatenate([frames, *(part[2] for part in closed)])
            begins = torch.cat([begins, *(part[3] for part in closed)])
            rows = self._rows_of(worlds.numpy())
            if state is not None:
                state = concatenate([state, state.select(rows.cpu())])
            sets = len(encoder_before)
            encoder_before = tuple(
                tree_map(lambda t, i=i: torch.cat([t, t[rows[i::sets] // sets]]), encoder_state)
                for i, encoder_state in enumerate(encoder_before)
            )
        return Rollout(
            self.stage.scenario,
            self.stage.noise_correlation,
            steps.to(device),
            frames,
            begins,
            encoder_before,
            None if state is None else state.apply(lambda tensor: tensor.to(device)),
            episodes,
            e * self.steps,
        )

    def _state_frames(self, states: list[Observation]) -> Frames:
        """Return the features of T + 1 true states, [B, T + 1, ...]."""
        together = tree_map(lambda *arrays: np.concatenate(arrays), *states)  # [(T + 1) E, ...]
        frames = state_features(self.policy.as_trained(together), self.stage.scenario)
        frames = state_sizes(self.policy.sizes, self.policy.waypoint_size).select(frames)
        shape = len(states), len(frames.ego) // len(states)
        return frames.apply(lambda x: x.view(*shape, *x.shape[2:]).transpose(0, 1).contiguous())

    def state_dict(self) -> dict[str, Any]:
        """Return all that the next `collect` depends on, in this module.

        Networks, torch's generator and the teacher's memory are not part of it.
        """
        return {
            "world": self.world.state,
            "crowd": () if self.crowd is None else self.crowd.world.state,
            "snapshots": list(self.snapshots.snapshots),
            "guide": None if self.guide is None else self.guide.memory,
            **{name: getattr(self, name) for name in SAVED},
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Continue from a state that `state_dict` returned."""
        self.world.restore(saved["world"])
        if self.crowd is not None:
            self.crowd.world.restore(saved["crowd"])
        self.snapshots.snapshots.extend(saved["snapshots"])
        if self.guide is not None:
            self.guide.restore(saved["guide"], saved["observation"])
        for name in SAVED:
            setattr(self, name, saved[name])
