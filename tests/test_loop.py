"""An estimator may fail in any way at any point: it ends its own run, and says why in one line."""

import signal
import sys
import warnings
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vislam.base.errors import Interrupted
from vislam.comparison.open import Dataset
from vislam.core.step import Final, State, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.estimators import loop


class Sound:
    """Drives straight on and fuses all that it may; a subclass breaks one thing."""

    def __init__(self):
        self.poses = []

    def process(self, frame):
        self.poses.append(np.eye(4))
        self.poses[-1][0, 3] = frame.stamp
        return Step(
            self.poses[-1],
            np.eye(6),
            {"twist_bias": State(np.zeros(6), np.ones(6))},
            nis=1.0,
            dof=3,
            log_likelihood=0.0,
            used=frame.stereo.usable,
        )

    def finalize(self):
        return Final(
            Poses(np.array(self.poses)),
            Landmarks(np.arange(2), np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))),
            counts={"frames": 1},
        )


class Broken(Sound):
    """Sound up to a frame; there ``change`` has its way with the answer, or raises."""

    def __init__(self, frame, change):
        super().__init__()
        self._frame, self._change = frame, change

    def process(self, frame):
        answer = super().process(frame)
        return self._change(answer, frame) if frame.k == self._frame else answer


class BrokenEnd(Sound):
    """Sound up to the end."""

    def __init__(self, change):
        super().__init__()
        self._change = change

    def finalize(self):
        return self._change(super().finalize())


def run(estimator, dataset, **options):
    sequence = dataset.sequence
    return loop.run(estimator, sequence, np.ones((sequence.observations, 3)), name="mine", **options)


def raising(failure):
    def change(*_):
        raise failure

    return change


RAISED = [
    ValueError("no"),
    KeyError("missing"),
    TypeError("bad type"),
    IndexError("out of bounds"),
    OSError(28, "No space left on device"),
    RuntimeError("first line\nsecond line"),
    RuntimeError(""),
    RuntimeError("x" * 10_000),
    MemoryError(),
    RecursionError("too deep"),
    StopIteration("x"),
    GeneratorExit(),
    SystemExit(0),
    SystemExit("gone"),
    KeyboardInterrupt(),
    UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"),
    np.linalg.LinAlgError("Singular matrix"),
    Warning("a warning"),
]


@pytest.fixture
def command_handles_signals(monkeypatch):
    """As inside a command, whose own handler tells Ctrl-C from an estimator's KeyboardInterrupt."""
    before = signal.signal(signal.SIGINT, lambda *_: None)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("command_handles_signals")
@pytest.mark.parametrize("failure", RAISED, ids=lambda failure: repr(failure)[:40])
def test_whatever_is_raised_ends_that_run_with_one_line(short: Dataset, failure):
    found = run(Broken(7, raising(failure)), short)
    assert not found.complete
    assert found.log.error.startswith("frame 7: ")
    assert "\n" not in found.log.error
    assert len(found.log.error) < 500
    assert len(found.stamp) == len(found.final.world_T_imu) == 7
    assert type(failure).__name__ in found.log.traceback
    late = run(BrokenEnd(raising(failure)), short)
    assert late.log.error.startswith("finalize: ")
    assert len(late.stamp) == len(short.sequence)


def skewed():
    cov = np.eye(6)
    cov[0, 1] = 0.5
    return cov


def turned(angle=0.0, scale=1.0):
    pose = np.eye(4)
    pose[:2, :2] = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return pose


STEPS = [
    ("pose", None, "(4, 4)"),
    ("pose", np.eye(3), "got (3, 3)"),
    ("pose", np.eye(4)[None], "got (1, 4, 4)"),
    ("pose", [[1.0], [2.0, 3.0]], "ragged"),
    ("pose", "pose", "real numbers"),
    ("pose", np.eye(4) * 1j, "complex"),
    ("pose", np.full((4, 4), np.nan), "finite"),
    ("pose", np.full((4, 4), np.inf), "finite"),
    ("pose", np.full((4, 4), 1e200), "rigid"),
    ("pose", turned(scale=1.1), "rigid"),
    ("pose", np.diag([1.0, 1.0, -1.0, 1.0]), "determinant -1"),
    ("pose", np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
    ("pose_cov", np.eye(3), "got (3, 3)"),
    ("pose_cov", -np.eye(6), "positive semi-definite"),
    ("pose_cov", skewed(), "symmetric"),
    ("pose_cov", np.diag([np.nan] + [1.0] * 5), "finite"),
    ("pose_cov", np.full((6, 6), np.inf), "finite"),
    ("spurious_information", np.zeros(5), "got (5,)"),
    ("nis", None, "real numbers"),
    ("nis", -5.0, "at least 0"),
    ("nis", np.nan, "finite"),
    ("nis", np.inf, "finite"),
    ("dof", 3.5, "whole number"),
    ("dof", -1, "at least 0"),
    ("dof", np.array([1, 2]), "got (2,)"),
    ("log_likelihood", "much", "real numbers"),
    ("used", np.ones(1, bool), "got (1,)"),
    ("gated", np.zeros((2, 2), bool), "got (2, 2)"),
    ("states", [np.zeros(6)], "a State by each name"),
    ("states", {"no name": State(np.zeros(6))}, "names of letters"),
    ("states", {3: State(np.zeros(6))}, "names of letters"),
    ("states.twist_bias", np.zeros(6), "a State"),
    ("states.twist_bias.value", State(np.zeros(3)), "got (3,)"),
    ("states.twist_bias.value", State(np.full(6, np.nan)), "finite"),
    ("states.other.value", State(np.zeros((2, 2))), "(m,)"),
    ("states.other.value", State(np.zeros(0)), "(m,)"),
    ("states.other.value", State(1.0), "(m,)"),
    ("states.twist_bias.sigma", State(np.zeros(6), np.zeros((6, 6))), "got (6, 6)"),
    ("states.twist_bias.sigma", State(np.zeros(6), np.array([np.nan] + [1.0] * 5)), "finite"),
    ("states.twist_bias.sigma", State(np.zeros(6), -np.ones(6)), "at least 0"),
]


@pytest.mark.parametrize(("field", "value", "message"), STEPS, ids=[f"{f}-{m}" for f, _, m in STEPS])
def test_a_step_of_the_wrong_form_names_frame_and_field(short: Dataset, field, value, message):
    first, *rest = field.split(".")
    wrong = {first: {rest[0]: value} if rest else value}
    found = run(Broken(3, lambda answer, *_: replace(answer, **wrong)), short)
    assert found.log.error.startswith(f"frame 3: {field} must ")
    assert message in found.log.error
    assert len(found.stamp) == 3


def test_masks_must_be_masks_of_the_frame(short: Dataset):
    integers = run(Broken(3, lambda answer, frame: replace(answer, used=np.arange(len(frame.stereo)))), short)
    assert integers.log.error == "frame 3: used must be a mask of bool, got an array of int64"
    count = len(short.sequence.track[short.sequence.offset[3] : short.sequence.offset[4]])
    longer = run(Broken(3, lambda answer, *_: replace(answer, used=np.ones(count + 1, bool))), short)
    assert longer.log.error == f"frame 3: used must be ({count},), got ({count + 1},)"


@pytest.mark.parametrize("answer", [None, {}, 3, "x", Final], ids=str)
def test_an_answer_that_is_none_is_said(short: Dataset, answer):
    assert "process must return a Step, got" in run(Broken(0, lambda *_: answer), short).log.error
    assert "finalize must return a Final, got" in run(BrokenEnd(lambda _: answer), short).log.error


ENDS = [
    ("trajectory", np.tile(np.eye(4), (25, 1, 1)), "Poses(array), got ndarray"),
    ("map", np.zeros((2, 3)), "Landmarks(track, points_world), got ndarray"),
    ("trajectory.world_T_imu", np.tile(np.eye(4), (3, 1, 1)), "got (3, 4, 4)"),
    ("trajectory.cov", np.eye(6), "got (6, 6)"),
    ("map.track", np.array([1, 1]), "each once"),
    ("map.track", np.array([-1, 1]), "from 0 on"),
    ("map.track", np.array([0.5, 1.0]), "integers"),
    ("map.track", None, "integers"),
    ("map.points_world", np.zeros((1, 3)), "(2, 3), got (1, 3)"),
    ("map.points_world", np.full((2, 3), np.nan), "finite"),
    ("map.points_cov", np.zeros((1, 3, 3)), "got (1, 3, 3)"),
    ("map.points_cov", -np.ones((2, 3, 3)), "positive semi-definite"),
    ("counts", None, "counts"),
    ("counts", {3: 4}, "counts"),
    ("counts", {"a": "b"}, "counts.a"),
    ("counts", {"a": 0.5}, "whole number"),
    ("counts", {"a": -1}, "at least 0"),
    ("events", ("fine", None), "lines of text"),
    ("events", "text", "lines of text"),
    ("up", np.zeros(3), "unit vector"),
    ("fused", (np.array([0]), np.array([0, 1])), "as many frames as tracks"),
    ("fused", np.array([0]), "a pair"),
    ("fused", (np.array([10**6]), np.array([10**6])), "no observations"),
    ("fit", 3.0, "sum of squares"),
    ("fit", (np.nan, 3), "finite"),
    ("fit", (1.0, 2.5), "whole number"),
]


@pytest.mark.parametrize(("field", "value", "message"), ENDS, ids=[f"{f}-{m}" for f, _, m in ENDS])
def test_an_end_of_the_wrong_form_keeps_the_frames(short: Dataset, field, value, message):
    *part, last = field.split(".")

    def change(final):
        inside = {last: value}
        return replace(final, **({part[0]: replace(getattr(final, part[0]), **inside)} if part else inside))

    found = run(BrokenEnd(change), short)
    assert found.log.error.startswith("finalize: ")
    assert message in found.log.error
    assert len(found.stamp) == len(short.sequence)
    assert found.map is None


def test_what_numpy_calls_a_number_is_one(short: Dataset):
    def change(answer, *_):
        return replace(answer, pose=np.eye(4, dtype=int), nis=np.float32(2), dof=np.int8(3))

    counts = {"a": np.int64(3), "b": np.float32(1)}
    assert run(Broken(2, change), short).complete
    found = run(BrokenEnd(lambda final: replace(final, counts=counts)), short)
    assert found.log.counts == {"a": 3, "b": 1}
    assert all(type(value) is int for value in found.log.counts.values())


def test_what_an_estimator_goes_on_changing_is_kept_as_it_was(short: Dataset):
    class Reuses(Sound):
        """One pose and one mask for all frames."""

        pose = np.eye(4)

        def process(self, frame):
            self.pose[0, 3] = frame.stamp
            return replace(super().process(frame), pose=self.pose)

    assert np.array_equal(run(Reuses(), short).filtered.world_T_imu[:, 0, 3], short.sequence.stamp)


@settings(max_examples=40, deadline=None)
@given(
    frame=st.integers(0, 24),
    field=st.sampled_from(
        [
            "stereo.track",
            "stereo.z",
            "stereo.sigma",
            "stereo.usable",
            "odometry.twist",
            "odometry.twist_change",
        ]
    ),
    base=st.booleans(),
)
def test_no_array_that_is_given_can_be_changed(short: Dataset, frame, field, base):
    def change(answer, given):
        array = attrgetter(field)(given)
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        owner = array
        while base and isinstance(owner.base, np.ndarray):
            owner = owner.base
        with pytest.raises(ValueError, match="WRITEABLE"):
            owner.flags.writeable = True
        raise RuntimeError("could not")

    assert run(Broken(frame, change), short).log.error == f"frame {frame}: RuntimeError: could not"


def test_what_was_rejected_for_all_and_fused_is_said(short: Dataset):
    usable = np.ones(short.sequence.observations, bool)
    usable[:5] = False

    class Ignores(Sound):
        def process(self, frame):
            return replace(super().process(frame), used=np.ones(len(frame.stereo), bool))

    assert run(Sound(), short, usable=usable).log.events == ()
    assert run(Ignores(), short, usable=usable).log.events == (
        "fused 5 observations that were rejected for all",
    )


def test_a_state_keeps_its_size_and_is_unknown_where_it_is_not_given(short: Dataset):
    class Sometimes(Sound):
        def process(self, frame):
            known = State([frame.k, 1.0], np.full(2, np.nan) if frame.k == 2 else np.ones(2))
            return replace(super().process(frame), states={"scale": known} if frame.k % 2 == 0 else {})

    found = run(Sometimes(), short).states["scale"]
    assert found.value.shape == found.sigma.shape == (len(short.sequence), 2)
    assert np.array_equal(found.value[::2, 0], np.arange(0, len(short.sequence), 2))
    assert np.isnan(found.value[1::2]).all()
    assert np.isnan(found.sigma[1:4]).all()
    assert np.array_equal(found.sigma[4], [1.0, 1.0])

    class Grows(Sound):
        def process(self, frame):
            return replace(super().process(frame), states={"scale": State(np.zeros(1 + frame.k // 3))})

    assert run(Grows(), short).log.error == "frame 3: states.scale.value must be (1,), got (2,)"


def test_poses_that_are_those_of_the_steps_are_not_kept_twice(short: Dataset):
    assert run(Sound(), short).smoothed is None
    assert run(BrokenEnd(lambda final: Final()), short).smoothed is None
    moved = run(BrokenEnd(lambda final: Final(Poses(final.trajectory.world_T_imu[::-1]))), short)
    assert np.array_equal(moved.final.world_T_imu, moved.filtered.world_T_imu[::-1])
    assert moved.smoothed.cov is None


def test_one_with_the_earlier_interface_is_told_the_new_one(short: Dataset):
    class Earlier(Sound):
        def process(self, frame, refused):
            raise AssertionError

    found = run(Earlier(), short)
    assert found.log.error == (
        "frame 0: process must take (frame), got (frame, refused): "
        "what was rejected is now ~frame.stereo.usable"
    )


def test_the_process_is_left_as_it_was(short: Dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()

    def change(answer, *_):
        np.seterr(all="raise")
        warnings.simplefilter("ignore")
        monkeypatch.chdir(tmp_path / "elsewhere")
        return answer

    before, filters = np.geterr(), list(warnings.filters)
    assert run(Broken(0, change), short).complete
    assert np.geterr() == before
    assert list(warnings.filters) == filters
    assert tmp_path.cwd() == tmp_path


@pytest.fixture
def interrupts():
    """Ctrl-C as Python itself handles it; a shell starts what is in the background without."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("interrupts")
def test_ctrl_c_and_sigterm_hand_over_what_was_done(short: Dataset):
    with pytest.raises(loop.RunInterrupted) as caught:
        run(Broken(4, raising(Interrupted())), short)
    assert caught.value.run.log.error == "frame 4: interrupted"
    assert len(caught.value.run.stamp) == 4
    # In a notebook it is Python itself that raises.
    with pytest.raises(loop.RunInterrupted):
        run(Broken(4, raising(KeyboardInterrupt())), short)


def test_an_estimator_that_cannot_be_built_never_began(short: Dataset):
    try:
        sys.exit(3)
    except SystemExit as failure:
        found = loop.not_run("mine", short.sequence, failure)
    assert found.log.error == "cannot be built: SystemExit: 3"
    assert not found.complete
    assert (len(found.stamp), found.frames_expected) == (0, len(short.sequence))
    assert "sys.exit(3)" in found.log.traceback
