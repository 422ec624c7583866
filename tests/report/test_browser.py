"""The page in a real browser: it draws, moves and sorts; in the dark, on a phone and on paper as well."""

import io
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image

from tests.inspection.test_page import FINDINGS, SERIES
from tests.records import altered
from tests.report.test_study_page import PIXELS
from tests.report.test_study_page import page as write_study
from tests.study.synthetic import study
from vislam import evaluate
from vislam.evaluation import evaluate as evaluate_runs
from vislam.inspection.finding import Inspection
from vislam.inspection.page import write_inspection
from vislam.ledger.entries import find
from vislam.ledger.page import write_index
from vislam.report.scene import scene_data
from vislam.report.shown import Shown

sync_api = pytest.importorskip("playwright.sync_api")

CHROMIUM = shutil.which("chromium")
# Root needs --no-sandbox; the rest draws WebGL without a graphics card.
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
PLOTLYS_OWN = ("Canvas2D: Multiple readback", "GL Driver Message")
"""Warnings about the drawing library's use of the browser."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed"),
]


@pytest.fixture(scope="module")
def playwright():
    with sync_api.sync_playwright() as started:
        yield started


@pytest.fixture(scope="module")
def browser(playwright):
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
    yield browser
    browser.close()


class Opened:
    """A page, with whatever it said and asked for."""

    def __init__(self, browser, path, **options):
        self.said, self.asked = [], []
        self.context = browser.new_context(offline=True, **options)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.said.append(f"{message.type}: {message.text}"))
        self.page.on("pageerror", lambda error: self.said.append(f"error: {error}"))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())

    def drawn(self):
        self.page.locator("#scene-plot").evaluate("(plot) => plot.scrollIntoView()")
        self.page.wait_for_selector("#scene-plot[data-drawn]", timeout=60_000)
        return self.page

    def complaints(self):
        return [line for line in self.said if not any(known in line for known in PLOTLYS_OWN)]


@pytest.fixture(scope="module")
def written(tiny):
    """The page that the command writes of the tiny comparison."""
    assert evaluate.main([str(tiny.folder)]) == 0
    return tiny.folder / "report.html"


@pytest.fixture
def opened(browser, written):
    """Open the page of the tiny comparison; it must neither complain nor ask for anything else."""
    pages = []

    def start(path=written, *, browser=browser, **options):
        pages.append(Opened(browser, path, **options))
        return pages[-1]

    yield start
    for each in pages:
        each.context.close()
        assert each.complaints() == []
        assert each.asked == [written.as_uri()]


def pixels(page):
    """Picture of the scene, ``(h, w, 3)``, once it has settled."""
    page.wait_for_timeout(300)
    return image.imread(io.BytesIO(page.locator("#scene-plot").screenshot()))[..., :3]


def coloured(picture):
    """Count the pixels that are neither grey nor paper: what is drawn of the runs, and their legend."""
    return np.count_nonzero(np.ptp(picture, axis=2) > 0.2)


def wait_until(page, condition):
    """Look every 50 ms for at most 10 s; the browser's own waiting is what the page's policy forbids."""
    for _ in range(200):
        if condition():
            return
        page.wait_for_timeout(50)
    pytest.fail("nothing happened in 10 s")


def move(page, frame):
    page.locator("#scene-slider").evaluate(
        "(slider, value) => { slider.value = value; slider.dispatchEvent(new Event('input')); }", str(frame)
    )


def moving_trace(page, which):
    return page.evaluate("(which) => Array.from(document.getElementById('scene-plot').data[which].x)", which)


def test_the_scene_is_drawn_and_the_slider_moves_it(opened):
    page = opened().drawn()
    late = pixels(page)
    assert coloured(late) > 500
    names = page.evaluate("document.getElementById('scene-plot').data.map((trace) => trace.name)")
    label, landmarks = page.inner_text("#scene-time"), moving_trace(page, names.index("map of ekf"))
    pose = moving_trace(page, names.index("pose of ekf"))
    move(page, 3)
    early = pixels(page)
    assert np.abs(early - late).max() > 0.3
    assert page.inner_text("#scene-time") != label
    assert "frame 3 of 29" in page.inner_text("#scene-time")
    assert 0 < len(moving_trace(page, names.index("map of ekf"))) < len(landmarks)
    assert moving_trace(page, names.index("pose of ekf")) != pose


def test_ellipsoids_grow_by_the_chosen_factor(opened):
    page = opened().drawn()
    names = page.evaluate("document.getElementById('scene-plot').data.map((trace) => trace.name)")
    # Nine values draw the body axes; the ellipses follow.
    sizes = []
    for factor in ("1", "100"):
        page.select_option("#scene-magnify", factor)
        page.wait_for_timeout(300)
        ellipse = np.array(moving_trace(page, names.index("pose of ekf"))[9:], float)
        sizes.append(np.nanmax(ellipse) - np.nanmin(ellipse))
    assert sizes[1] / sizes[0] == pytest.approx(100.0, rel=1e-3)


def test_play_moves_on_by_itself_and_stops_when_told(opened):
    page = opened().drawn()
    page.click("#scene-play")
    wait_until(page, lambda: int(page.input_value("#scene-slider")) > 2)
    page.click("#scene-play")
    stopped = page.input_value("#scene-slider")
    page.wait_for_timeout(400)
    assert page.input_value("#scene-slider") == stopped
    assert page.inner_text("#scene-play") == "Play"


def test_every_view_is_another_picture_of_the_same_things(opened):
    page = opened().drawn()
    last = pixels(page)
    legend = last[: last.shape[0] // 3, :160]
    for view in ("above", "side", "oblique"):
        page.click(f"[data-view={view}]")
        picture = pixels(page)
        assert np.abs(picture - last).max() > 0.3
        assert coloured(picture) > coloured(legend) + 300
        last = picture


def test_without_webgl_the_page_says_so_and_nothing_fails(playwright, opened):
    flags = ["--no-sandbox", "--disable-gpu", "--disable-3d-apis"]
    plain = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
    try:
        start = opened(browser=plain)
        start.page.wait_for_selector("#scene-missing", state="visible")
        assert not start.page.is_visible("#scene-body")
        assert start.complaints() == []
    finally:
        plain.close()


def tables(page):
    """Tables that sort, but for the one at a glance."""
    return page.locator("table.sortable:not(.summary)")


def names_in(table):
    return table.locator("tbody th").all_inner_texts()


def rows(page):
    return names_in(tables(page).first)


@pytest.mark.parametrize("press", [lambda button: button.click(), lambda button: button.press("Enter")])
def test_a_header_sorts_the_rows_and_again_reverses_them(opened, tiny, press):
    page = opened().page
    names = list(tiny.runs)
    assert rows(page) == names
    table = tables(page).nth(2)
    assert names_in(table) == names
    header = table.locator("th", has_text="peak memory")
    assert header.inner_text().split() == ["peak", "memory", "[MB]", "?"]
    value = {name: round(tiny.evaluation.value(name, "peak_rss_mb")) for name in names}
    press(header.locator("button"))
    upwards = names_in(table)
    assert [value[name] for name in upwards] == sorted(value.values())
    assert header.get_attribute("aria-sort") == "ascending"
    press(header.locator("button"))
    assert [value[name] for name in names_in(table)] == sorted(value.values(), reverse=True)
    assert header.get_attribute("aria-sort") == "descending"
    by_error = tables(page).first.locator("th", has_text="ATE, SE(3)").locator("button")
    press(by_error)
    press(by_error)
    assert rows(page)[0] == "dead_reckoning"
    assert tables(page).first.locator("[aria-sort]").count() == 1


def test_a_missing_number_comes_last_either_way(opened, tiny):
    page = opened().page
    table = tables(page).nth(1)
    button = table.locator("th", has_text="NIS per").locator("button")
    for _ in range(2):
        button.click()
        cells = table.locator("tbody tr").all()
        missing = ["-" in row.locator("td").all_inner_texts() for row in cells]
        assert missing == sorted(missing)
        assert any(missing)


def luminance(colour):
    channels = np.array(re.findall(r"[\d.]+", colour)[:3], float) / 255.0
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(one, other):
    """Contrast ratio of WCAG 2, from 1 to 21."""
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def paper(page):
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


def computed(page, selector, what="color"):
    return page.locator(selector).first.evaluate("(e, what) => getComputedStyle(e)[what]", what)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_and_series_stand_out_from_the_paper_in_both_themes(opened, scheme):
    page = opened(color_scheme=scheme).page
    assert (luminance(paper(page)) < 0.1) is (scheme == "dark")
    for selector in ("p.verdict", "p.quiet", "nav a", "figcaption", "td"):
        assert contrast(computed(page, selector), paper(page)) > 4.5
    assert contrast(computed(page, "figure svg text", "fill"), paper(page)) > 4.5
    lines = page.locator("figure svg path[style*='var(--c']").evaluate_all(
        "(paths) => [...new Set(paths.map((path) => getComputedStyle(path).stroke))]"
    )
    lines = [colour for colour in lines if colour != "none"]
    assert len(lines) >= 3
    assert all(contrast(colour, paper(page)) > 2.5 for colour in lines)


def test_the_theme_is_turned_over_from_the_keyboard_and_the_scene_follows(opened):
    page = opened(color_scheme="light").drawn()
    before, scene = paper(page), pixels(page)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    assert page.get_attribute("#theme", "aria-pressed") == "true"
    assert luminance(paper(page)) < 0.1 < luminance(before)
    ink = page.evaluate("document.getElementById('scene-plot').layout.font.color")
    assert contrast(ink, paper(page)) > 4.5
    assert np.median(pixels(page)) < 0.2 < np.median(scene)
    page.keyboard.press("Space")
    assert paper(page) == before


def test_a_phone_has_no_sideways_scrolling_but_in_tables_and_figures(opened):
    page = opened(viewport={"width": 390, "height": 844}).drawn()
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    first = tables(page).first.locator("tbody th").first
    box = first.bounding_box()
    page.locator(".wide").first.evaluate("(box) => { box.scrollLeft = 200; }")
    assert page.locator(".wide").first.evaluate("(box) => box.scrollLeft") == 200
    assert first.bounding_box()["x"] == pytest.approx(box["x"], abs=1.0)


def test_paper_has_no_controls_and_shows_what_was_closed(opened):
    page = opened(color_scheme="dark").drawn()
    page.emulate_media(media="print")
    page.wait_for_timeout(200)
    assert luminance(paper(page)) == 1.0
    assert computed(page, "p.verdict") == "rgb(0, 0, 0)"
    for selector in ("#theme", "nav", "#scene-slider", "#scene-plot"):
        assert not page.is_visible(selector)
    assert page.is_visible(".print-only")
    assert page.locator("details:not([open])").count() == 0
    assert page.pdf(format="A4").startswith(b"%PDF")
    page.emulate_media(media="screen")
    wait_until(page, lambda: page.locator("details[open]").count() == 0)


def hidden_columns(page):
    """Boxes that are wider than what is seen of them and do not say so."""
    return page.locator(".wide").evaluate_all(
        """(boxes) => boxes.filter((box) => box.offsetParent && box.scrollWidth > box.clientWidth + 1
          && getComputedStyle(box, "::before").content.indexOf("scroll") < 0).length"""
    )


def sideways(page):
    """Labels of the boxes that are seen and scroll sideways."""
    return page.locator(".wide").evaluate_all(
        """(boxes) => boxes.filter((box) => box.offsetParent && box.scrollWidth > box.clientWidth + 1)
          .map((box) => box.getAttribute("aria-label").split(",")[0])"""
    )


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_hidden_without_a_hint_to_scroll(opened, width):
    page = opened(viewport={"width": width, "height": 900}).page
    page.evaluate("for (const item of document.querySelectorAll('details')) item.open = true")
    page.wait_for_timeout(200)
    assert hidden_columns(page) == 0
    # On a wide screen everything fits; on a phone tables and figures have to scroll.
    assert (not sideways(page)) is (width == 1400)
    assert page.evaluate("document.documentElement.scrollWidth") == width


def test_the_first_screen_says_who_is_better_whose_covariance_to_trust_and_at_what_cost(opened, tiny):
    page = opened(viewport={"width": 1400, "height": 900}).page
    table = page.locator("table.summary")
    box = table.bounding_box()
    assert box["y"] + box["height"] < 900
    assert page.locator("p.answer").first.bounding_box()["y"] < box["y"]
    heads = table.locator("thead th").all_inner_texts()
    for wanted in ("ATE", "against the lowest", "held-out", "sigmas", "90 % region", "step", "total time"):
        assert any(wanted in head for head in heads)
    assert set(names_in(table)) == set(tiny.runs)
    assert any("lowest" in row for row in table.locator("tbody tr").all_inner_texts())


def text_sizes(page):
    """Sizes of all texts that are seen, as they are drawn [px]."""
    page.evaluate("for (const item of document.querySelectorAll('details')) item.open = true")
    return page.evaluate(
        """() => [...document.querySelectorAll("body *")]
          .filter((item) => [...item.childNodes].some((node) => node.nodeType === 3 && node.data.trim())
            && !["SCRIPT", "STYLE"].includes(item.tagName) && item.getClientRects().length)
          .map((item) => parseFloat(getComputedStyle(item).fontSize)
            * (item.getScreenCTM ? Math.hypot(item.getScreenCTM().a, item.getScreenCTM().b) : 1))"""
    )


def test_the_smallest_text_on_a_phone_is_11_px(opened):
    sizes = text_sizes(opened(viewport={"width": 390, "height": 844}).page)
    assert len(sizes) > 300
    assert min(sizes) > 10.95


@pytest.fixture(scope="module")
def others(written, tmp_path_factory):
    """The other pages: of a study, an inspection and a ledger."""
    folder = tmp_path_factory.mktemp("others")
    write_study(folder, study(PIXELS))
    result = Inspection("drive", FINDINGS, SERIES)
    ledger = write_index(written.parent.parent, find(written.parent.parent))
    return {
        "study": folder / "study.html",
        "inspection": write_inspection(folder, result, synthetic=True, config="name: drive"),
        "ledger": ledger,
    }


@pytest.mark.parametrize("width", [1400, 390])
@pytest.mark.parametrize("which", ["study", "inspection", "ledger"])
def test_the_other_pages_fit_can_be_read_and_ask_for_nothing(browser, others, which, width):
    start = Opened(browser, others[which], viewport={"width": width, "height": 900})
    sizes = text_sizes(start.page)
    start.page.wait_for_timeout(200)
    assert hidden_columns(start.page) == 0
    assert (not sideways(start.page)) is (width == 1400)
    assert start.page.evaluate("document.documentElement.scrollWidth") == width
    assert len(sizes) > 30
    assert min(sizes) > 10.95
    start.context.close()
    assert start.complaints() == []
    assert start.asked == [others[which].as_uri()]


def test_the_wheel_scrolls_the_page_until_the_scene_has_the_focus(opened):
    page = opened(viewport={"width": 1000, "height": 700}).drawn()
    page.locator("#scene-plot").evaluate("(plot) => plot.scrollIntoView({block: 'center'})")
    box = page.locator("#scene-plot").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    place = "document.scrollingElement.scrollTop"
    before = page.evaluate(place)
    page.mouse.wheel(0, 120)
    wait_until(page, lambda: page.evaluate(place) > before + 50)
    page.locator("#scene-plot").evaluate("(plot) => plot.scrollIntoView({block: 'center'})")
    page.mouse.click(box["x"] + 300, box["y"] + 200)
    page.wait_for_timeout(300)
    before, picture = page.evaluate(place), pixels(page)
    page.mouse.wheel(0, 120)
    page.wait_for_timeout(500)
    assert page.evaluate(place) == before
    assert np.abs(pixels(page) - picture).max() > 0.3
    page.keyboard.press("Escape")
    page.mouse.wheel(0, 120)
    wait_until(page, lambda: page.evaluate(place) > before + 50)


def square(tiny):
    """The tiny comparison with one run whose path is a square of 100 m."""
    run = tiny.runs["ekf"]
    corner = np.array([[0, 0], [100, 0], [100, 100], [0, 100], [0, 0]], float)
    world = np.tile(np.eye(4), (len(run.stamp), 1, 1))
    along = np.linspace(0.0, 4.0, len(world))
    world[:, :2, 3] = np.column_stack([np.interp(along, np.arange(5), values) for values in corner.T])
    return altered(run, world_T_imu=world, map=None)


def test_a_square_loop_is_square_from_above(tiny, browser, tmp_path):
    runs = {"ekf": square(tiny)}
    record = replace(tiny.record, reference=None)
    shown = Shown.of(runs, record, evaluation := evaluate_runs(runs, record), ())
    parts = {"runs": runs, "record": record, "evaluation": evaluation, "travelled": shown.travelled()}
    tiny.page(tmp_path / "report.html", figures={}, scene=scene_data(shown), **parts)
    start = Opened(browser, tmp_path / "report.html")
    page = start.drawn()
    page.click("[data-view=above]")
    page.wait_for_timeout(300)
    red, green, blue = np.moveaxis(pixels(page), 2, 0)
    drawn = (red - blue > 0.35) & (red - green > 0.15)
    # The legend is at the upper left, apart from the box in the middle.
    drawn[:, : drawn.shape[1] // 4] = False
    rows, columns = np.flatnonzero(drawn.any(axis=1)), np.flatnonzero(drawn.any(axis=0))
    assert np.ptp(rows) > 60
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(1.0, abs=0.06)
    start.context.close()
    assert start.complaints() == []


def test_figures_over_time_are_drawn_over_the_distance_and_back(opened):
    page = opened().page
    line = page.locator("#figure-height_attitude g[id*='line2d'] path[style*='var(--c1)']").first
    label = page.locator("#figure-height_attitude text", has_text="time [s]")
    before = line.get_attribute("d")
    assert label.count() == 1
    page.click("[data-abscissa=distance]")
    assert label.count() == 0
    assert page.locator("#figure-height_attitude text", has_text="distance travelled [m]").count() == 1
    ends = [re.findall(r"[ML]\s*([\d.]+)", path) for path in (before, line.get_attribute("d"))]
    assert len(ends[0]) == len(ends[1])
    assert ends[0] != ends[1]
    # Where the drive begins and ends is the same place in both.
    assert float(ends[1][0]) == pytest.approx(float(ends[0][0]), abs=2.0)
    assert (np.diff(np.array(ends[1], float)) >= 0.0).all()
    page.click("[data-abscissa=time]")
    assert line.get_attribute("d") == before


def test_paper_has_the_whole_configuration_without_a_script(playwright, written):
    plain = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
    try:
        page = plain.new_context(java_script_enabled=False).new_page()
        page.goto(written.as_uri())
        closed = page.locator("details pre").last.bounding_box()
        page.emulate_media(media="print")
        opened_up = page.locator("details pre").last.bounding_box()
        assert opened_up["height"] > 500.0
        assert closed is None or closed["height"] < opened_up["height"]
        # A page printed whole: nothing of the configuration is cut off at the right.
        assert page.locator("details pre").last.evaluate("(pre) => pre.scrollWidth <= pre.clientWidth + 1")
    finally:
        plain.close()
