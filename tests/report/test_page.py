"""The page as text: whole, of its own, the same twice, and safe against what names and notes may hold."""

import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.records import altered
from vislam.evaluation import evaluate
from vislam.evaluation.metric import METRICS
from vislam.report import time_figures
from vislam.report.colours import COLOURS, colours
from vislam.report.figures import all_figures, figure_names
from vislam.report.scene import scene_data, three_sigma_axes, unpacked
from vislam.report.shown import Shown
from vislam.report.svg import themed_svg

EVIL = "<script>alert(1)</script>\"&'"
VOID = {"meta", "link", "input", "path", "use", "image", "br"}


class Elements(HTMLParser):
    """Elements in order, their attributes, and whether each is closed where it should be."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def all(self, tag):
        return [attributes for name, attributes in self.found if name == tag]


def without_bundle(text):
    return re.sub(r'<script type="text/plain" id="plotly">.*?</script>', "", text, flags=re.DOTALL)


@pytest.fixture(scope="module")
def text(tiny, tmp_path_factory):
    checks = [(True, "one that holds"), (False, "one that does not"), (None, "one nobody can tell")]
    return tiny.page(tmp_path_factory.mktemp("page") / "report.html", checks=checks)


@pytest.fixture(scope="module")
def elements(text):
    found = Elements(without_bundle(text))
    assert not found.open
    return found


def test_headings_descend_one_at_a_time(elements):
    levels = [int(tag[1]) for tag, _ in elements.found if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert np.diff(levels).max() <= 1
    assert elements.all("html")[0]["lang"] == "en"


def test_every_id_stands_once_and_every_link_and_reference_finds_one(text, elements):
    ids = Counter(attributes["id"] for _, attributes in elements.found if "id" in attributes)
    assert max(ids.values()) == 1
    wanted = {link["href"][1:] for link in elements.all("a") + elements.all("use")}
    wanted |= set(re.findall(r"url\(#([^)]+)\)", without_bundle(text)))
    assert wanted <= set(ids)


def test_every_figure_is_drawn_once_and_says_what_it_shows(elements):
    found = [figure["id"].removeprefix("figure-") for figure in elements.all("figure")]
    # There are no ablation chain, lags, bound and images; thirty frames are too few for the whiteness, and
    # isam2 claims nothing.
    lacking = ("ablation", "lag", "bound", "divergence", "whiteness", "distances", "disparities")
    assert found == [name for name in figure_names() if name.partition("_")[0] not in lacking]
    drawn = elements.all("svg")
    assert len(drawn) == len(found)
    assert all(len(svg["aria-label"]) > 20 and svg["role"] == "img" for svg in drawn)


def test_nothing_is_fetched_from_anywhere(text, elements):
    assert not re.search("https?:", without_bundle(text))
    for _, attributes in elements.found:
        for name in ("src", "href"):
            assert attributes.get(name, "#").startswith(("#", "data:"))
    (policy,) = (m["content"] for m in elements.all("meta") if "http-equiv" in m)
    assert policy.startswith("default-src 'none'")
    assert "unsafe-eval" not in policy


@pytest.mark.slow
def test_the_same_results_give_the_same_bytes(tiny, tmp_path):
    assert tiny.page(tmp_path / "a.html") == tiny.page(tmp_path / "b.html")


@pytest.mark.slow
def test_figures_have_no_black_white_or_series_colour_of_their_own(tiny):
    for name, drawing in all_figures(tiny.shown).items():
        svg = themed_svg(drawing.svg, drawing.figure, name, colours=COLOURS)
        for colour in ("#000000", "#ffffff", *COLOURS):
            assert colour.lower() not in svg
        assert "currentColor" in svg
        # The colours of paths by their error are those of the error.
        assert ("var(--c" in svg) is not name.startswith("error_path")


def test_a_check_is_told_by_a_word_and_comes_before_the_verdict(text):
    words = re.findall(r"</span> ([a-z ]+)</b> <span>(one [a-z ]+)</span>", text)
    assert words == [
        ("holds", "one that holds"),
        ("does not hold", "one that does not"),
        ("cannot be told", "one nobody can tell"),
    ]
    assert text.index("one nobody can tell") < text.index('<p class="answer">')


def test_the_table_has_a_row_for_each_estimator(tiny, text):
    body = text[text.index('<table class="numbers sortable"') :]
    body = body[: body.index("</table>")]
    assert re.findall(r'<th scope="row">([^<]+)</th>', body) == list(tiny.runs)
    values = [tiny.evaluation.value(name, "ate_rmse", "filtered") for name in tiny.runs]
    places = METRICS["ate_rmse"].places(values)
    shown = f"{tiny.evaluation.value('ekf', 'ate_rmse', 'filtered'):.{places}f}"
    assert len(shown.lstrip("0.")) >= 2
    assert f'<th scope="row">ekf</th><td>{shown}</td>' in body


def test_each_metric_of_the_table_has_its_definition_one_click_away(text, elements):
    linked = {link["href"] for link in elements.all("a") if link.get("class") == "what"}
    assert "#metric-nis_per_dof" in linked
    assert {f"#{term['id']}" for term in elements.all("dt")} == linked
    assert "1 is expected" in text


@pytest.mark.slow
def test_names_and_notes_are_text_whatever_they_hold(tiny, tmp_path):
    runs = {EVIL: altered(tiny.runs["ekf"], name=EVIL, error=EVIL, events=(EVIL,), counts={EVIL: 1})}
    reference = replace(tiny.record.reference, name=EVIL, limits=EVIL)
    record = replace(tiny.record, reference=reference, notes=(EVIL,), provenance={EVIL: EVIL})
    evaluation = evaluate(runs, record)
    shown = Shown.of(runs, record, evaluation, ())
    text = tiny.page(
        tmp_path / "report.html",
        title=EVIL,
        runs=runs,
        record=record,
        evaluation=evaluation,
        figures=all_figures(shown),
        scene=scene_data(shown),
        checks=[(None, EVIL)],
        common_set=EVIL,
        config=EVIL,
    )
    assert "<script>alert" not in text
    assert text.count("alert(1)") > 10
    assert not Elements(without_bundle(text)).open


def test_a_page_without_reference_runs_or_scene_is_whole(tiny, tmp_path):
    record = replace(tiny.record, reference=None)
    shown = Shown({}, record, evaluate({}, record), ())
    assert scene_data(shown)["runs"] == []
    text = tiny.page(
        tmp_path / "report.html",
        runs={},
        record=record,
        evaluation=shown.evaluation,
        figures={},
        scene={},
        travelled=shown.travelled(),
    )
    assert not Elements(text).open
    assert "plotly" not in text.lower()
    assert len(text) < 100_000


def test_a_run_without_covariances_or_map_is_drawn(tiny):
    bare = altered(tiny.runs["ekf"], points_cov=None, cov=None)
    runs = {"bare": bare, "no map": tiny.runs["dead_reckoning"]}
    record = replace(tiny.record, reference=None)
    shown = Shown.of(runs, record, evaluate(runs, record), ())
    figure = all_figures(shown)["top_view"].figure
    assert "map of bare (no covariances)" in [axes.get_title() for axes in figure.axes]
    assert np.isnan(unpacked(scene_data(shown)["runs"][0]["semi_axes"])).all()


def test_the_page_is_small(text):
    assert len(without_bundle(text)) < 1_500_000
    assert len(text.encode()) < 4_000_000


def test_a_name_has_one_colour_wherever_it_is_shown():
    few, many = colours(["isam2", "ekf"]), colours(["dead_reckoning", "ekf", "mine", "isam2", "eks"])
    assert few["ekf"] == many["ekf"]
    assert few["isam2"] == many["isam2"]
    assert colours(["mine"])["mine"] == many["mine"] or many["mine"] not in (few["ekf"], few["isam2"])
    assert len(set(many.values())) == len(many)
    assert len(set(colours(map(str, range(len(COLOURS)))).values())) == len(COLOURS)
    assert len(colours(map(str, range(40)))) == 40


def test_no_letter_of_a_figure_is_smaller_than_11_px_at_its_least_width(text):
    figures = re.findall(r'<svg role="img"[^>]*>.*?</svg>', text, re.DOTALL)
    assert len(figures) > 10
    for svg in figures:
        width = float(re.search(r'viewBox="0 0 ([\d.]+)', svg)[1])
        least = float(re.search(r"min-width: (\d+)px", svg)[1])
        sizes = [float(size) for size in re.findall(r"font-size: ([\d.]+)px", svg)]
        assert min(sizes) * least / width > 10.95
        assert least < 700


def test_what_sees_nothing_sets_no_scale_and_says_how_far_it_goes(tiny):
    far = tiny.runs["dead_reckoning"]
    world = far.filtered.world_T_imu.copy()
    world[:, 2, 3] += np.linspace(0.0, 1e3, len(world))
    runs = tiny.runs | {"dead_reckoning": replace(far, filtered=replace(far.filtered, world_T_imu=world))}
    evaluation = evaluate(runs, tiny.record)
    shown = Shown.of(runs, tiny.record, evaluation, ())
    height = time_figures.height_attitude(shown).axes[0]
    assert np.ptp(height.get_ylim()) < 10.0
    assert any("dead_reckoning: to" in told.get_text() for told in height.texts)
    scene = scene_data(shown)
    assert np.subtract(scene["high"], scene["low"]).max() < 300.0


def test_the_ellipsoid_is_three_sigma_in_every_direction(rng):
    root = rng.normal(size=(5, 3, 3))
    cov = root @ np.swapaxes(root, 1, 2)
    axes = three_sigma_axes(cov)
    np.testing.assert_allclose(axes @ np.swapaxes(axes, 1, 2), 9.0 * cov, rtol=1e-9, atol=1e-9)


def test_the_scene_holds_each_path_on_the_reference_and_landmarks_when_first_seen(tiny):
    scene = scene_data(tiny.shown)
    for entry in scene["runs"]:
        run = tiny.shown.runs[entry["name"]]
        path = unpacked(entry["path"]).reshape(-1, 3)
        error = np.linalg.norm(path - tiny.record.reference.position, axis=1)
        ate = tiny.evaluation.value(run.name, "ate_rmse")
        # float32 of a few hundred metres is good to 0.03 mm.
        assert np.sqrt(np.mean(error**2)) == pytest.approx(ate, abs=1e-3)
        first = unpacked(entry["first_seen"])
        assert (np.diff(first) >= 0).all()
        assert len(first) == entry["landmarks_drawn"] == len(unpacked(entry["landmarks"])) / 3


def test_landmarks_are_first_seen_in_the_frame_of_their_first_observation(tiny):
    run, given = tiny.runs["ekf"], tiny.record.given
    for track, frame in zip(run.landmarks.track[:20], tiny.shown.first_seen(run)[:20], strict=True):
        assert frame == given.frame[given.track == track].min()
