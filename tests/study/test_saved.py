"""Files of trials that were edited, cut short or are of another: taken only if they are what they say."""

import copy
import json
import math
import os
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vislam.comparison.identity import code_digest
from vislam.study.folder import StudyFolder
from vislam.study.points import Point, Trial, all_trials
from vislam.study.summary import reasons_of, rows_of
from vislam.study.trial import run_trial
from vislam.study.trials import Trials

PIXELS = "noise.pixel_sigma_px"
SLOW_FIXTURE = settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])


@pytest.fixture(scope="module")
def trial(short_config):
    config = replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}})
    (found,) = all_trials([Point.of(config, {PIXELS: 1.0})], seeds=range(3, 4), code=code_digest())
    return found


@pytest.fixture(scope="module")
def result(trial):
    return run_trial(trial.point.tree, trial.seed)


@pytest.fixture
def folder(tmp_path, trial, result):
    """Folder of a study with one finished trial."""
    found = StudyFolder(tmp_path / "study")
    found.save(trial, result)
    return found


def file_of(folder, trial):
    return folder.path / "trials" / f"{trial.id}.json"


def document(folder, trial):
    return json.loads(file_of(folder, trial).read_text(encoding="utf-8"))


def write(folder, trial, content):
    text = content if isinstance(content, str) else json.dumps(content)
    file_of(folder, trial).write_text(text, encoding="utf-8")


def use(folder, trial):
    """All that a study does with its files."""
    folder.write_table(lambda: [trial], swept={PIXELS: [1.0]}, metrics=[])
    records = (
        {"seed": one.seed, "point": one.point.values, **found} for one, found in folder.finished([trial])
    )
    trials = Trials.of_records(records)
    return rows_of(trials), reasons_of(trials)


def test_a_finished_trial_is_taken(folder, trial, result):
    found = folder.find(trial)
    assert found == {"id": trial.id, "seed": 3, "values": {PIXELS: 1.0}, **result}
    assert folder.refused == set()
    assert len(use(folder, trial)[0]) == 2


LIES = {
    "id": "0123456789abcdef",
    "seed": 4,
    "values": {PIXELS: 1},
    "code": "0123456789",
    "inputs": "0123456789",
    "status": "finished",
}


@pytest.mark.parametrize("key", LIES)
def test_a_file_that_says_something_else_than_its_name_is_not_taken(key, folder, trial):
    write(folder, trial, document(folder, trial) | {key: LIES[key]})
    assert folder.find(trial) is None
    assert folder.refused == {trial.id}


@pytest.mark.parametrize("key", [*LIES, "runs", "metrics", "statistics", "reason", "seconds"])
def test_a_file_that_lacks_something_is_not_taken(key, folder, trial):
    found = document(folder, trial)
    del found[key]
    write(folder, trial, found)
    assert folder.find(trial) is None


def test_the_file_of_another_trial_is_not_taken(folder, trial, result):
    other = Trial("f" * 16, trial.point, trial.seed + 1)
    folder.save(other, result)
    file_of(folder, other).replace(file_of(folder, trial))
    assert folder.find(trial) is None
    assert folder.refused == {trial.id}


def change(found, how):
    """The same document, changed."""
    found = copy.deepcopy(found)
    how(found)
    return found


WRONG = {
    "a run is missing": lambda d: d["runs"].pop("ekf"),
    "a run too many": lambda d: d["runs"].update(other={"complete": True, "error": ""}),
    "a run of text": lambda d: d["runs"].update(ekf="complete"),
    "complete as a number": lambda d: d["runs"]["ekf"].update(complete=1),
    "numbers of an incomplete run": lambda d: d["runs"]["ekf"].update(complete=False),
    "a metric twice": lambda d: d["metrics"].append(d["metrics"][0]),
    "a metric of nobody": lambda d: d["metrics"][0].update(estimator="nobody"),
    "text for a number": lambda d: d["metrics"][0].update(value="1.0"),
    "truth for a number": lambda d: d["metrics"][0].update(value=True),
    "not a number": lambda d: d["metrics"][0].update(value=math.nan),
    "infinity": lambda d: d["metrics"][0].update(value=math.inf),
    "a number beyond all": lambda d: d["metrics"][0].update(value=10**400),
    "no list": lambda d: d.update(metrics={}),
    "half a character": lambda d: d.update(reason="\ud800"),
    "time that ran back": lambda d: d.update(seconds=-1.0),
    "failed with runs": lambda d: d.update(status="failed"),
    "a key of its own": lambda d: d.update(more=1),
    "a statistic of text": lambda d: d["statistics"].append("x"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_is_no_result_is_not_taken(case, folder, trial):
    write(folder, trial, change(document(folder, trial), WRONG[case]))
    assert folder.find(trial) is None
    assert folder.refused == {trial.id}


CONTENTS = {
    "empty": "",
    "null": "null",
    "a list": "[]",
    "deep": "[" * 100_000,
    "deep and whole": "[" * 100_000 + "]" * 100_000,
    "digits": "9" * 5000,
}


@pytest.mark.parametrize("case", CONTENTS)
def test_what_is_no_document_is_not_taken(case, folder, trial):
    write(folder, trial, CONTENTS[case])
    assert folder.find(trial) is None


def test_what_is_no_text_is_not_taken(folder, trial):
    file_of(folder, trial).write_bytes(b"\xff\xfe\x00")
    assert folder.find(trial) is None


def test_a_huge_file_is_not_read(folder, trial):
    os.truncate(file_of(folder, trial), 1 << 40)
    assert folder.find(trial) is None


@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo])
def test_what_is_no_file_is_not_opened(make, folder, trial):
    path = file_of(folder, trial)
    path.unlink()
    make(path)
    assert folder.find(trial) is None


def test_a_lost_trial_runs_again_and_is_no_lie(folder, trial):
    folder.save(
        trial,
        {
            **{"status": "lost", "reason": "KilledWorker", "runs": {}, "metrics": [], "statistics": []},
            **{"seconds": None, "code": code_digest(), "inputs": ""},
        },
    )
    assert folder.find(trial) is None
    assert folder.refused == set()


def test_values_that_no_number_equals_are_still_their_own(folder, short_config, result):
    point = Point.of(replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}}), {PIXELS: 1.0})
    (odd,) = all_trials(
        [replace(point, values={"a": math.nan, "b": (1, {2: True})})], seeds=range(3, 4), code=code_digest()
    )
    folder.save(odd, result)
    assert folder.find(odd) is not None


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers()
    | st.sampled_from([10**400, -(2**70), "\ud800", "\0", "done", "failed", "lost", 1e308])
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)


def places(value, path=()):
    """Paths to everything inside plain data."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


@SLOW_FIXTURE
@given(data=st.data())
def test_no_edit_is_taken_that_lies_and_none_ends_in_a_traceback(data, folder, trial, result):
    whole = {"id": trial.id, "seed": trial.seed, "values": trial.point.values, **result}
    small = change(whole, lambda d: (d.update(metrics=d["metrics"][:3]), d.update(statistics=[])))
    found = copy.deepcopy(small)
    for _ in range(data.draw(st.integers(1, 3))):
        *above, last = data.draw(st.sampled_from([path for path in places(found) if path] or [("id",)]))
        inside = found
        for key in above:
            inside = inside[key]
        if data.draw(st.booleans()) or isinstance(inside, list):
            inside[last] = data.draw(JSON)
        else:
            inside.pop(last, None)
    write(folder, trial, found)
    taken = folder.find(trial)
    use(folder, trial)
    if taken is not None:
        assert {key: taken[key] for key in ("id", "seed", "code", "inputs")} == {
            key: small[key] for key in ("id", "seed", "code", "inputs")
        }
        assert json.dumps(taken["values"]) == json.dumps(small["values"])
        assert taken["status"] in ("done", "failed")


@SLOW_FIXTURE
@given(damage=st.tuples(st.floats(0, 1), st.binary(max_size=3), st.booleans()))
def test_no_damage_to_the_bytes_ends_in_a_traceback(damage, folder, trial, result):
    place, put, cut = damage
    folder.save(trial, result)
    path = file_of(folder, trial)
    content = path.read_bytes()
    at = int(place * len(content))
    path.write_bytes(content[:at] + put + (b"" if cut else content[at + len(put) :]))
    taken = folder.find(trial)
    use(folder, trial)
    assert taken is None or (taken["id"], taken["seed"]) == (trial.id, trial.seed)
