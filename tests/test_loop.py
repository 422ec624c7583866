"""An estimator may fail in any way at any point: it ends its own run, and says why in one line."""

import signal
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vislam.base.errors import Interrupted
from vislam.comparison.open import Dataset
from vislam.core.estimator import Estimate, StepRecord
from vislam.estimators import loop


class Sound:
    """Drives straight on and fuses all that it may; a subclass breaks one thing."""

    def __init__(self):
        self.poses = []

    def process(self, frame, refused):
        self.poses.append(np.eye(4))
        self.poses[-1][0, 3] = frame.stamp
        return StepRecord(
            self.poses[-1], np.eye(6), np.zeros(6), np.ones(6), 1.0, 3, 0.0, ~refused, np.zeros_like(refused)
        )

    def finalize(self):
        track = np.arange(2)
        return Estimate(
            np.array(self.poses), None, track, np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), {"frames": 1}
        )


class Broken(Sound):
    """Sound up to a frame; there ``change`` has its way with the answer, or raises."""

    def __init__(self, frame, change):
        super().__init__()
        self._frame, self._change = frame, change

    def process(self, frame, refused):
        answer = super().process(frame, refused)
        return self._change(answer, frame, refused) if frame.k == self._frame else answer


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
    assert found.error.startswith("frame 7: ")
    assert "\n" not in found.error
    assert len(found.error) < 500
    assert len(found.stamp) == len(found.world_T_imu) == 7
    assert type(failure).__name__ in found.traceback
    late = run(BrokenEnd(raising(failure)), short)
    assert late.error.startswith("finalize: ")
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
    ("world_T_imu", None, "(4, 4)"),
    ("world_T_imu", np.eye(3), "got (3, 3)"),
    ("world_T_imu", np.eye(4)[None], "got (1, 4, 4)"),
    ("world_T_imu", [[1.0], [2.0, 3.0]], "ragged"),
    ("world_T_imu", "pose", "real numbers"),
    ("world_T_imu", np.eye(4) * 1j, "complex"),
    ("world_T_imu", np.full((4, 4), np.nan), "finite"),
    ("world_T_imu", np.full((4, 4), np.inf), "finite"),
    ("world_T_imu", np.full((4, 4), 1e200), "rigid"),
    ("world_T_imu", turned(scale=1.1), "rigid"),
    ("world_T_imu", np.diag([1.0, 1.0, -1.0, 1.0]), "determinant -1"),
    ("world_T_imu", np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
    ("pose_cov", np.eye(3), "got (3, 3)"),
    ("pose_cov", -np.eye(6), "positive semi-definite"),
    ("pose_cov", skewed(), "symmetric"),
    ("pose_cov", np.diag([np.nan] + [1.0] * 5), "finite"),
    ("pose_cov", np.full((6, 6), np.inf), "finite"),
    ("bias", np.zeros(3), "got (3,)"),
    ("bias", np.full(6, np.nan), "finite"),
    ("bias_sigma", np.zeros((6, 6)), "got (6, 6)"),
    ("world_gained", np.zeros(5), "got (5,)"),
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
]


@pytest.mark.parametrize(("field", "value", "message"), STEPS, ids=[f"{f}-{m}" for f, _, m in STEPS])
def test_a_step_of_the_wrong_form_names_frame_and_field(short: Dataset, field, value, message):
    found = run(Broken(3, lambda answer, *_: replace(answer, **{field: value})), short)
    assert found.error.startswith(f"frame 3: {field} must be")
    assert message in found.error
    assert len(found.stamp) == 3


def test_masks_must_be_masks_of_the_frame(short: Dataset):
    integers = run(
        Broken(3, lambda answer, frame, _: replace(answer, used=np.arange(len(frame.track)))), short
    )
    assert integers.error == "frame 3: used must be a mask of bool, got an array of int64"
    count = len(short.sequence.track[short.sequence.offset[3] : short.sequence.offset[4]])
    longer = run(Broken(3, lambda answer, *_: replace(answer, used=np.ones(count + 1, bool))), short)
    assert longer.error == f"frame 3: used must be ({count},), got ({count + 1},)"


@pytest.mark.parametrize("answer", [None, {}, 3, "x", Estimate], ids=str)
def test_an_answer_that_is_none_is_said(short: Dataset, answer):
    assert "process must return a StepRecord, got" in run(Broken(0, lambda *_: answer), short).error
    assert "finalize must return an Estimate, got" in run(BrokenEnd(lambda _: answer), short).error


ENDS = [
    ("world_T_imu", np.tile(np.eye(4), (3, 1, 1)), "got (3, 4, 4)"),
    ("pose_cov", np.eye(6), "got (6, 6)"),
    ("track", np.array([1, 1]), "each once"),
    ("track", np.array([-1, 1]), "from 0 on"),
    ("track", np.array([0.5, 1.0]), "integers"),
    ("track", None, "integers"),
    ("points_world", np.zeros((1, 3)), "(2, 3), got (1, 3)"),
    ("points_world", np.full((2, 3), np.nan), "finite"),
    ("points_cov", np.zeros((1, 3, 3)), "got (1, 3, 3)"),
    ("points_cov", -np.ones((2, 3, 3)), "positive semi-definite"),
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
    found = run(BrokenEnd(lambda estimate: replace(estimate, **{field: value})), short)
    assert found.error.startswith("finalize: ")
    assert message in found.error
    assert len(found.stamp) == len(short.sequence)
    assert len(found.track) == 0


def test_what_numpy_calls_a_number_is_one(short: Dataset):
    def change(answer, *_):
        return replace(answer, world_T_imu=np.eye(4, dtype=int), nis=np.float32(2), dof=np.int8(3))

    counts = {"a": np.int64(3), "b": np.float32(1)}
    assert run(Broken(2, change), short).complete
    found = run(BrokenEnd(lambda estimate: replace(estimate, counts=counts)), short)
    assert found.counts == {"a": 3, "b": 1}
    assert all(type(value) is int for value in found.counts.values())


def test_what_an_estimator_goes_on_changing_is_kept_as_it_was(short: Dataset):
    class Reuses(Sound):
        """One pose and one mask for all frames."""

        pose = np.eye(4)

        def process(self, frame, refused):
            self.pose[0, 3] = frame.stamp
            return replace(super().process(frame, refused), world_T_imu=self.pose)

    assert np.array_equal(run(Reuses(), short).world_T_imu_causal[:, 0, 3], short.sequence.stamp)


@settings(max_examples=40, deadline=None)
@given(
    frame=st.integers(0, 24),
    field=st.sampled_from(["track", "z", "sigma", "twist", "twist_change"]),
    base=st.booleans(),
)
def test_no_array_that_is_given_can_be_changed(short: Dataset, frame, field, base):
    def change(answer, given, refused):
        for array in (getattr(given, field), refused):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
            owner = array
            while base and isinstance(owner.base, np.ndarray):
                owner = owner.base
            with pytest.raises(ValueError, match="WRITEABLE"):
                owner.flags.writeable = True
        raise RuntimeError("could not")

    assert run(Broken(frame, change), short).error == f"frame {frame}: RuntimeError: could not"


def test_what_was_rejected_for_all_and_fused_is_said(short: Dataset):
    refused = np.zeros(short.sequence.observations, bool)
    refused[:5] = True

    class Ignores(Sound):
        def process(self, frame, refused):
            return super().process(frame, np.zeros_like(refused))

    assert run(Sound(), short, refused=refused).events == ()
    assert run(Ignores(), short, refused=refused).events == (
        "fused 5 observations that were rejected for all",
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
    assert caught.value.run.error == "frame 4: interrupted"
    assert len(caught.value.run.stamp) == 4
    # In a notebook it is Python itself that raises.
    with pytest.raises(loop.RunInterrupted):
        run(Broken(4, raising(KeyboardInterrupt())), short)


def test_an_estimator_that_cannot_be_built_never_began(short: Dataset):
    try:
        sys.exit(3)
    except SystemExit as failure:
        found = loop.not_run("mine", short.sequence, failure)
    assert found.error == "cannot be built: SystemExit: 3"
    assert not found.complete
    assert (len(found.stamp), found.frames_expected) == (0, len(short.sequence))
    assert "sys.exit(3)" in found.traceback
