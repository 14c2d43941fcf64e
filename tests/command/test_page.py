"""Pages: what they say, that nothing in them can run or reach out, and how a browser shows them."""

import base64
import hashlib
import itertools
import re
import shlex
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import browser
import numpy as np
import pngfile
import pytest
from command import Desk
from hypothesis import given
from hypothesis import strategies as st
from stackreports import HOSTILE, LABELS, LAYERS, SIZE, hostile_report, report_of, three_results

import hpcomp
from hpcomp import hue_histogram
from hpcomp.errors import printable
from hpcomp.report import huepage
from hpcomp.report.look import Look, percent
from hpcomp.report.markup import Markup, digits, h, isolated, lines, rendered
from hpcomp.report.page import Section, page
from hpcomp.report.pagepictures import mask, png_bytes, shown_size
from hpcomp.report.stackpage import as_html, layer_color

REPORT = report_of()
HUES = [(name, hue_histogram(pixels)) for name, pixels in zip(HOSTILE, LAYERS, strict=False)]

VOID = {"meta", "link", "img", "input"}


class Page(HTMLParser):
    """A page read strictly: every element that begins ends, in order, and ids are of one each.

    `elements`: name and attributes of each. `texts`: what stands in elements of each name.
    """

    def __init__(self, content):
        super().__init__(convert_charrefs=True)
        self.open, self.elements, self.texts = [], [], {}
        text = content.decode("utf-8")
        assert text.startswith("<!doctype html>\n")
        self.feed(text)
        self.close()
        assert self.open == []
        self.ids = [attributes["id"] for _, attributes in self.elements if "id" in attributes]
        assert len(set(self.ids)) == len(self.ids)

    def handle_starttag(self, tag, attrs):
        names = [name for name, _ in attrs]
        assert len(set(names)) == len(names), (tag, attrs)
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        for tag in set(self.open):
            self.texts[tag] = self.texts.get(tag, "") + data

    def all(self, tag, **attributes):
        return [
            found
            for name, found in self.elements
            if name == tag and all(found.get(k.rstrip("_")) == v for k, v in attributes.items())
        ]


def stack_page(**changes):
    return as_html(replace(REPORT, **changes))


PAGES = {
    "stack": stack_page(),
    "without pictures": stack_page(preview=None, command="", settings={}),
    "hostile": as_html(hostile_report()),
    "background": as_html(report_of(background=(0.1, 0.3, 0.1), order="simultaneous")),
    "hues": huepage.as_html(HUES, Look()),
    "one image": huepage.as_html(HUES[1:2], Look(scale="log", weight="chroma")),
    "three results": as_html(three_results()),
    "fine bins": as_html(report_of(bins=3600)),
}


# ---- markup ----------------------------------------------------------------------------------


@given(st.text(alphabet=st.characters()), st.text(alphabet=st.characters()))
def test_what_goes_into_a_page_comes_out_as_text(content, attribute):
    """Surrogates, controls and all: as text, and never as anything else."""

    class Reader(HTMLParser):
        seen = ()

        def handle_starttag(self, tag, attrs):
            self.seen += ((tag, attrs),)

        def handle_data(self, data):
            self.seen += (data,)

    reader = Reader(convert_charrefs=True)
    reader.feed(rendered(h.html[h.p(title=attribute)[content]]).decode())
    reader.close()
    shown = ["\n".join(map(printable, text.split("\n"))) for text in (content, attribute)]
    assert reader.seen[:3] == ("\n", ("html", []), ("p", [("title", shown[1])]))
    assert "".join(reader.seen[3:]) == f"{shown[0]}\n"


def test_names_from_outside_stay_on_their_line():
    read = Page(rendered(h.html[isolated("a\nb\u202e<i>")]))
    assert read.texts["bdi"] == "a\\nb\\u202e<i>"
    assert read.all("bdi") == [{"dir": "ltr"}]


def test_lines():
    assert str(h.p[lines("a", "", None, h.b["c<d"], Markup("&amp;"))]) == "<p>a\n<b>c&lt;d</b>\n&amp;</p>"
    assert str(h.p[lines("a", "b", by=" ")]) == "<p>a b</p>"
    assert str(h.p[lines()]) == str(h.p[lines("", None)]) == "<p></p>"
    assert [digits(value) for value in (3.0, 0.5, 1 / 3, 100)] == ["3", "0.5", "0.33", "100"]


# ---- every page ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PAGES)
def test_page_is_well_formed(name):
    read = Page(PAGES[name])
    for tag, attributes in read.elements:
        for key in ("aria-labelledby", "data-map", "for"):
            if key in attributes:
                assert attributes[key] in read.ids, (tag, attributes)
        if tag == "a":
            assert attributes["href"].removeprefix("#") in read.ids
        fill = re.fullmatch(r"url\(#(.*)\)", attributes.get("fill", ""))
        assert fill is None or fill[1] in read.ids
        assert "style" not in attributes  # which the policy forbids
        assert not [key for key in attributes if key.startswith("on")]


@pytest.mark.parametrize("name", PAGES)
def test_page_says_what_it_is(name):
    read = Page(PAGES[name])
    assert read.all("html") == [{"lang": "en"}]
    assert read.all("meta", charset="utf-8")
    assert read.all("meta", name="viewport", content="width=device-width, initial-scale=1")
    assert all(len(read.all(tag)) == 1 for tag in ("head", "h1", "main", "header", "footer"))
    names = [tag for tag, _ in read.elements]
    assert names[: names.index("body")].count("title") == 1
    headings = [int(tag[1]) for tag, _ in read.elements if re.fullmatch("h[1-6]", tag)]
    assert headings[0] == 1
    assert all(b - a <= 1 for a, b in itertools.pairwise(headings))
    assert all("alt" in image for image in read.all("img"))
    assert all(i.get("aria-label") or i.get("type") == "checkbox" for i in read.all("input"))


@pytest.mark.parametrize("name", PAGES)
def test_page_asks_for_nothing(name):
    read = Page(PAGES[name])
    for tag, attributes in read.elements:
        for key in ("src", "href", "srcset", "action", "data", "poster", "xlink:href"):
            address = attributes.get(key, "#")
            assert address.startswith(("#", "data:image/png;base64,")) or address == "data:,", (tag, address)
    assert not re.search(r"@import|url\((?!#)", read.texts["style"])
    assert not re.search(r"fetch|XMLHttp|import\(|eval|innerHTML|https?:|//\w+\.", read.texts["script"])
    assert [tag for tag, _ in read.elements if tag in ("iframe", "object", "embed", "base", "form")] == []


@pytest.mark.parametrize("name", PAGES)
def test_policy_names_what_may_run(name):
    read = Page(PAGES[name])
    (policy,) = [m["content"] for m in read.all("meta") if m.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for tag in ("style", "script"):
        assert len(read.all(tag)) == 1
        digest = base64.b64encode(hashlib.sha256(read.texts[tag].encode()).digest()).decode()
        assert rules[f"{tag}-src"] == f"'sha256-{digest}'"


@pytest.mark.parametrize("name", PAGES)
def test_page_has_no_time_and_is_the_same_again(name):
    again = {
        "stack": stack_page,
        "hues": lambda: huepage.as_html(HUES, Look()),
    }.get(name)
    assert again is None or again() == PAGES[name]
    assert not re.search(rb"\b20\d\d-\d\d|GMT|/tmp|/home", PAGES[name])


def test_page_of_parts():
    sections = [Section("a", "First & last", "<x>"), Section("b", "B", "")]
    read = Page(page("Kind", "a<b", "so", sections))
    assert read.texts["title"] == "a<b · Kind"
    assert [link["href"] for link in read.all("a")] == ["#main", "#a", "#b"]
    assert read.texts["h2"] == "First & lastB"


# ---- names that mean harm --------------------------------------------------------------------


def test_hostile_names_become_text():
    content = PAGES["hostile"]
    read = Page(content)
    assert len(read.all("script")) == len(read.all("style")) == 1
    assert [image["src"][:10] for image in read.all("img")] == ["data:image"] * len(read.all("img"))
    assert "<img src=x onerror=window.harmed=1>.png" in read.texts["h1"]
    for label in HOSTILE:
        assert printable(label) in read.texts["bdi"]
    text = content.decode()
    assert not [c for c in text if not c.isprintable() and c != "\n"]


def test_hostile_command_can_be_pasted():
    """A shell that reads what the page shows gets the very words."""
    read = Page(PAGES["hostile"])
    given_names = [name.replace("\0", "") for name in HOSTILE]  # no command line holds NUL
    shown = Page(stack_page(command=shlex.join(["printf", "%s\\0", *given_names]))).texts["code"]
    assert shown.isprintable()
    done = subprocess.run(["bash", "-c", shown.encode()], capture_output=True, check=True)
    assert done.stdout.split(b"\0")[:-1] == [n.encode(errors="surrogateescape") for n in given_names]
    assert read.texts["code"].startswith("hpcomp stack ")


def test_command_that_is_plain_is_shown_as_it_is():
    assert Page(PAGES["stack"]).texts["code"] == REPORT.command
    assert "code" not in Page(PAGES["without pictures"]).texts
    assert "It was made from Python" in Page(PAGES["without pictures"]).texts["section"]


# ---- what a stack's page says ----------------------------------------------------------------


def test_a_third_result_has_its_numbers_and_its_picture():
    report = three_results()
    read = Page(PAGES["three results"])
    found = report.summary.measures
    terms = [text for text in ("woven", "traditional", "hue-preserving") if text in read.texts["dt"]]
    assert terms == ["woven", "traditional", "hue-preserving"]
    for result in found.results.values():
        for value in (result.foreign_share, result.lost, result.visible_share):
            assert percent(value) in read.texts["dd"]
        assert f" {percent(result.layers[2].visible_share)}" in " " + read.texts["td"]
    assert "All charts have one scale" in read.texts["main"]
    assert "Small print: traditional and hue-preserving blending." in read.texts["caption"]
    chosen = ["selected" in option for option in read.all("option")]
    assert chosen == [True, False, False, False, False, True]
    assert read.texts["option"] == "traditionalhue-preservingwoven (the file)" * 2
    assert [figure.get("class") for figure in read.all("figure") if "data-picture" in figure] == [
        "before", None, "after"
    ]  # fmt: skip
    for picture, image in zip(report.preview.pictures.values(), images_of(read), strict=False):
        assert np.array_equal(picture, image)
    assert "select" not in Page(PAGES["stack"]).texts


def test_numbers_of_a_stack():
    read = Page(PAGES["stack"])
    found = REPORT.summary.measures
    said = read.texts["dd"]
    for result in (found.result, found.traditional):
        for value in (result.foreign_share, result.foreign_chroma_share, result.lost, result.visible_share):
            assert percent(value) in said
        assert percent(result.energy() / found.pixels) in said
    assert percent(found.order_sensitivity) in said
    assert "weigh 0.3, 0.25 and 0.45" in read.texts["main"]
    assert "more than 4° from that of every layer" in read.texts["main"]
    assert read.texts["header"].count("Every coloured pixel has the hue of something") == 1
    assert f"{percent(found.traditional.foreign_share)} have not" in read.texts["header"]
    assert f"A reader finds {percent(found.result.visible_share)} of what" in read.texts["header"]
    assert "1.2.3" in said
    assert "kernel" in said


def test_lead_of_what_loses_hues():
    report = report_of(blending="traditional")
    share = percent(report.summary.measures.result.foreign_share)
    header = Page(as_html(report)).texts["header"]
    assert f"{share} of the coloured pixels have a hue that nothing there gave them" in header
    grey = Page(as_html(report_of([LAYERS[0]] * 2, ["a", "b"]))).texts["header"]
    assert "No pixel has a hue." in grey
    one = Page(as_html(report_of(LAYERS[:2], LABELS[:2]))).texts["header"]
    assert "all have, too" in one


def test_rows_of_layers():
    read = Page(PAGES["stack"])
    assert len(read.all("tr")) == 1 + len(LABELS)
    for name in ("base.png", "red.png", "roads: yellow.png", "blue.exr"):
        assert name in read.texts["th"]
    assert "layer 0" not in read.texts["th"]
    found = REPORT.summary.measures.result.layers[2]
    for words in (f"{found.pixels:,}", percent(found.survived_share), percent(found.visible_share), percent(found.lost)):
        assert words in read.texts["td"]
    assert "background" not in read.texts["th"]
    assert "background" in Page(PAGES["background"]).texts["th"]


def test_unmeasured_pixels_are_told():
    broken = LAYERS[1].copy()
    broken[12, 16] = np.nan
    read = Page(as_html(report_of([LAYERS[0], broken], ["a", "b"], preview=False)))
    assert "1 hold NaN or Inf and are left out." in read.texts["main"]


def images_of(read):
    return [pngfile.decode(base64.b64decode(i["src"].partition(",")[2])) for i in read.all("img")]


def test_pictures_are_those_of_the_preview():
    read = Page(PAGES["stack"])
    plain, ours, *masks = images_of(read)
    assert np.array_equal(plain, REPORT.preview.pictures["traditional"])
    assert np.array_equal(ours, REPORT.preview.pictures["hue-preserving"])
    assert "hue-preserving (the file)" in read.texts["figcaption"]
    assert "traditional (the file)" not in read.texts["figcaption"]
    numbers = [int(i["id"].removeprefix("map-")) for i in read.all("img") if "id" in i]
    assert len(masks) == len(numbers)
    whole = np.zeros(SIZE[::-1], int)
    for layer, picture in zip(numbers, masks, strict=True):
        seen = picture[..., 3] > 0
        whole[seen] = layer + 1
        color = bytes.fromhex(layer_color(REPORT.summary.layers[layer])[1:])
        assert (picture[seen] == (*color, 255)).all()
    assert np.array_equal(whole, REPORT.preview.provenance)
    assert "4 × 4 of the picture" in read.texts["main"]


def test_page_without_pictures():
    read = Page(PAGES["without pictures"])
    assert read.all("img") == read.all("input") == []
    assert 'id="provenance"' not in PAGES["without pictures"].decode()


@given(st.integers(1, 40), st.integers(1, 40), st.integers(0, 5))
def test_png_of_a_picture_is_the_picture(height, width, seed):
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)
    assert np.array_equal(pngfile.decode(png_bytes(pixels)), pixels)
    assert np.array_equal(mask(pixels[..., 0] > 99, "#102030")[..., 3] > 0, pixels[..., 0] > 99)


def test_a_picture_leaves_no_temporary_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    png_bytes(np.zeros((3, 4, 4), np.uint8))
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with pytest.raises(hpcomp.OutputError, match="pictures of the report cannot be written: no such"):
        png_bytes(np.zeros((3, 4, 4), np.uint8))


@pytest.mark.parametrize(
    ("size", "shown"),
    [((960, 540), (1100, 619, False)), ((480, 510), (678, 720, False)), ((64, 48), (960, 720, True)),
     ((1, 1), (16, 16, True)), ((960, 1), (1100, 1, False)), ((2, 960), (2, 720, False))],
)  # fmt: skip
def test_pictures_fit_a_screen(size, shown):
    assert shown_size(*size) == shown


# ---- charts ----------------------------------------------------------------------------------


@pytest.mark.parametrize("bins", [6, 360, 3600])
def test_charts_hold_their_histograms(bins):
    found = hue_histogram(np.concatenate([layer.reshape(-1, 4) for layer in LAYERS]), bins=bins)
    (chart,) = Page(huepage.as_html([("x", found)], Look())).all("svg", class_="plot")
    pairs = [pair.split(":") for pair in chart["data-shares"].split(",")]
    assert [int(index) for index, _ in pairs] == np.flatnonzero(found.count).tolist()
    shares = 100 * found.shares()[found.count > 0]
    assert [float(share) for _, share in pairs] == pytest.approx(shares, rel=0.01)
    assert int(chart["data-bins"]) == bins


def test_bars_are_as_high_as_their_shares():
    """On a linear scale; the bar at 330°, where the axis begins, is cut in two."""
    red = (0.5, 0.0, 0.0, 1.0)
    found = hue_histogram([red, red, (0.5, 0, 0.25, 1.0)], bins=36)
    read = Page(huepage.as_html([("x", found)], Look(scale="linear")))
    (bars,) = read.all("path", class_="bars")
    levels = [100 - float(level) for level in re.findall(r"V([\d.]+)h", bars["d"])]
    assert sorted(levels) == pytest.approx([50 / 1.04, 50 / 1.04, 100 / 1.04], abs=0.02)
    places = [float(place) for place in re.findall(r"M([\d.-]+) ", bars["d"])]
    assert places == [-35, -5, 325]


def test_peaks_are_told_in_words():
    read = Page(PAGES["stack"])
    found = REPORT.summary.result
    for peak in found.peaks:
        assert f"{peak.hue:.1f}°: {percent(peak.share)} of the pixels with a hue" in read.texts["title"]
        assert f" {peak.hue:.1f}° {percent(peak.share)}" in read.texts["li"]
    labels = [plot["aria-label"] for plot in read.all("svg", class_="plot")]
    assert labels[0].startswith("Hue histogram. Peaks, with their shares")


def test_page_of_hues(tmp_path):
    desk = Desk.made(tmp_path)
    hpcomp.write_image(desk / "a.png", LAYERS[1])
    hpcomp.write_image(desk / "b.png", LAYERS[3])
    desk.makes("hues", "a.png", "b.png", "-o", "hues.html")
    read = Page((desk / "hues.html").read_bytes())
    assert read.texts["h1"] == "2 images"
    assert "a.png" in read.texts["h3"]
    assert "b.png" in read.texts["h3"]
    piped = desk.makes("hues", "a.png", "b.png", "--format", "html")
    assert piped.stdout == (desk / "hues.html").read_bytes()


# ---- in a browser ----------------------------------------------------------------------------

needs_browser = pytest.mark.skipif(
    browser.chromium() is None, reason="no Chromium: install the package chromium"
)


@pytest.fixture(scope="module")
def tab():
    """A browser that is started once."""
    opened = browser.Browser()
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The pages as files."""
    folder = tmp_path_factory.mktemp("pages")
    for name, content in PAGES.items():
        (folder / f"{name}.html").write_bytes(content)
    return folder


def split_of(tab):
    """Where the frame is divided, in percent, as it is drawn and as it is told."""
    drawn = tab.value(
        "(() => { const f = document.getElementById('compare').getBoundingClientRect();"
        "const h = document.querySelector('.handle').getBoundingClientRect();"
        "return 100 * (h.left + h.width / 2 - f.left) / f.width; })()"
    )
    told = int(tab.value("document.getElementById('split').getAttribute('aria-valuetext')").split("%")[0])
    assert told == pytest.approx(drawn, abs=0.6)
    return drawn


#: Text that is seen, and is nearer to what is behind it than WCAG 2.2 AA (1.4.3) allows.
FAINT = """
(() => {
  const parse = (c) => { const v = c.match(/[\\d.]+/g).map(Number); return [...v.slice(0, 3), v[3] ?? 1]; };
  const linear = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = (c) => 0.2126 * linear(c[0]) + 0.7152 * linear(c[1]) + 0.0722 * linear(c[2]);
  const behind = (el) => {
    for (; el; el = el.parentElement) {
      const c = parse(getComputedStyle(el).backgroundColor);
      if (c[3] === 1) return c;
    }
    return [255, 255, 255, 1];
  };
  const faint = [];
  let seen = 0;
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const el = walk.currentNode.parentElement;
    if (!walk.currentNode.data.trim() || el.closest("title") || !el.checkVisibility()) continue;
    const style = getComputedStyle(el);
    const color = parse(el.closest("svg") ? style.fill : style.color);
    const [a, b] = [light(color), light(behind(el))].sort((x, y) => y - x);
    const size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    seen += 1;
    if ((a + 0.05) / (b + 0.05) < (large ? 3 : 4.5)) faint.push(walk.currentNode.data);
  }
  return [seen, faint];
})()
"""


@pytest.mark.pairwise
@needs_browser
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [360, 1280])
@pytest.mark.parametrize("name", PAGES)
def test_browser_shows_a_page_without_complaint(tab, files, name, width, dark):
    tab.open(files / f"{name}.html", width=width, dark=dark)
    assert tab.problems == []
    assert tab.value("document.documentElement.scrollWidth") == width
    seen, faint = tab.value(FAINT)
    assert seen > 10
    assert faint == []
    assert tab.value("window.harmed ?? null") is None


@needs_browser
def test_light_and_dark_differ(tab, files):
    grounds = []
    for dark in (False, True):
        tab.open(files / "stack.html", dark=dark)
        grounds.append(tab.value("getComputedStyle(document.body).backgroundColor"))
    assert grounds == ["rgb(255, 255, 255)", "rgb(22, 22, 22)"]


@needs_browser
def test_policy_stops_what_got_in(tab, files, tmp_path):
    """Even if a name were not escaped, nothing of it would run."""
    harm = "<script>window.harmed=1</script><img src=x onerror='window.harmed=1'><p style='color:red' id=red>"
    broken = tmp_path / "broken.html"
    broken.write_bytes(PAGES["stack"].replace(b"<footer>", harm.encode() + b"<footer>"))
    tab.open(broken)
    assert tab.value("window.harmed ?? null") is None
    assert tab.value("getComputedStyle(document.getElementById('red')).color") != "rgb(255, 0, 0)"
    assert tab.problems  # it says what it stopped


@needs_browser
def test_slider_by_keys(tab, files):
    tab.open(files / "stack.html")
    assert split_of(tab) == pytest.approx(50)
    for _ in range(20):
        tab.page.keyboard.press("Tab")
        if tab.value("document.activeElement.id") == "split":
            break
    assert tab.value("document.activeElement.id") == "split"
    ring = "getComputedStyle(document.querySelector('.handle svg')).boxShadow"
    assert "rgb(11, 87, 208)" in tab.value(ring)
    places = []
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "End", "ArrowLeft", "Home", "ArrowUp"):
        tab.page.keyboard.press(key)
        places.append(split_of(tab))
    assert 50 < places[0] < places[1]
    assert places[2] == pytest.approx(places[0])
    assert places[3] == 100
    assert 80 < places[4] < 100
    assert places[5] == 0
    assert 0 < places[6] < 20
    tab.value("document.getElementById('split').blur()")
    assert "rgb(11, 87, 208)" not in tab.value(ring)


@needs_browser
def test_slider_by_mouse(tab, files):
    tab.open(files / "stack.html")
    left, top, width = tab.value(
        "(() => { const f = document.getElementById('compare').getBoundingClientRect();"
        "return [f.left, f.top, f.width]; })()"
    )
    at = lambda share: (left + share * width, top + 60)  # noqa: E731
    mouse = tab.page.mouse
    mouse.move(*at(0.25))
    mouse.down()
    assert split_of(tab) == pytest.approx(25, abs=0.5)
    mouse.move(*at(0.8))
    assert split_of(tab) == pytest.approx(80, abs=0.5)
    mouse.move(left + 2 * width, top + 60)
    assert split_of(tab) == 100
    mouse.up()
    mouse.move(*at(0.1))
    assert split_of(tab) == 100


@needs_browser
def test_any_two_of_three_pictures_are_compared(tab, files):
    """By keys alone; what is chosen at one side leaves the other, and the slider says what it moves."""
    tab.open(files / "three results.html")

    def shown():
        """Names of the pictures at the left and at the right, as drawn."""
        return tab.value(
            "['before', 'after'].map((side) => [...document.querySelectorAll('.compare figure')].filter("
            "(f) => f.checkVisibility() && f.classList.contains(side)).map((f) => f.dataset.name).join())"
        )

    said = "document.getElementById('split').getAttribute('aria-valuetext')"
    assert shown() == ["traditional", "woven"]
    assert tab.value(said) == "50% traditional, 50% woven"
    tab.value("document.getElementById('left').focus()")
    tab.page.keyboard.press("ArrowDown")
    assert shown() == ["hue-preserving", "woven"]
    assert tab.value(said) == "50% hue-preserving, 50% woven"
    tab.page.keyboard.press("ArrowDown")  # the one at the right: they change places
    assert shown() == ["woven", "hue-preserving"]
    assert tab.value("document.getElementById('right').value") == "1"
    tab.value("document.getElementById('right').focus()")
    tab.page.keyboard.press("ArrowUp")
    assert shown() == ["woven", "traditional"]
    tab.value("document.getElementById('split').focus()")
    tab.page.keyboard.press("End")
    assert tab.value(said) == "100% woven, 0% traditional"
    assert tab.value("document.querySelectorAll('.compare figure').length") == 3


@needs_browser
def test_pictures_are_clipped_where_the_slider_is(tab, files):
    """At either end, one picture alone is seen, and transparent parts show no other picture."""
    shots = {}
    for key in ("Home", "End"):
        tab.open(files / "stack.html")
        tab.value("document.getElementById('split').focus()")
        tab.page.keyboard.press(key)
        tab.value("document.querySelectorAll('.handle').forEach((e) => e.remove())")
        shot = pngfile.decode(tab.page.screenshot())
        box = tab.value(
            "(() => { const f = document.querySelector('.before img').getBoundingClientRect();"
            "return [f.left, f.top, f.width, f.height]; })()"
        )
        zoom = box[2] / SIZE[0]
        # The middle of each pixel of the preview that is in sight.
        rows = [r for r in range(SIZE[1]) if box[1] + (r + 0.5) * zoom < len(shot) and r * zoom > 60]
        shots[key] = np.array(
            [[shot[int(box[1] + (r + 0.5) * zoom), int(box[0] + (c + 0.5) * zoom), :3] for c in range(SIZE[0])] for r in rows]
        )
        wanted = REPORT.preview.pictures[{"Home": "hue-preserving", "End": "traditional"}[key]][rows]
        opaque = wanted[..., 3] == 255
        assert opaque.sum() > 200
        assert np.abs(shots[key][opaque].astype(int) - wanted[opaque][:, :3]).max() <= 2
    assert not np.array_equal(shots["Home"], shots["End"])


@needs_browser
def test_layers_of_the_map_are_shown_and_hidden_by_keys(tab, files):
    tab.open(files / "stack.html")
    shown = (
        "[...document.querySelectorAll('.map img')]"
        ".map((i) => getComputedStyle(i).visibility === 'visible')"
    )
    n_maps = len(tab.value(shown))
    assert tab.value(shown) == [True] * n_maps
    tab.value("document.querySelectorAll('input[data-map]')[1].focus()")
    tab.page.keyboard.press(" ")
    assert tab.value(shown) == [k != 1 for k in range(n_maps)]
    for kind, state in (("none", False), ("all", True)):
        tab.value(f"document.querySelector('button[data-show={kind}]').focus()")
        tab.page.keyboard.press("Enter")
        assert tab.value(shown) == [state] * n_maps
        assert tab.value("document.querySelectorAll('input[data-map]')[1].checked") is state


@needs_browser
def test_chart_is_read_by_keys_and_mouse(tab, files):
    tab.open(files / "stack.html")
    found = REPORT.summary.traditional
    plot = "document.querySelectorAll('.plot')[1]"
    readout = "document.querySelectorAll('.readout')[1].textContent"
    tab.value(f"{plot}.scrollIntoView({{block: 'center'}})")
    tab.value(f"{plot}.focus()")
    tab.page.keyboard.press("Home")
    seen = []
    for _ in range(found.occupied):
        assert tab.value(f"{plot}.getAttribute('aria-valuetext')") == tab.value(readout)
        seen.append(tab.value(readout))
        tab.page.keyboard.press("ArrowRight")
    hues = [int(text.partition("°")[0]) for text in seen]
    assert sorted(hues) == np.flatnonzero(found.count).tolist()
    assert hues == sorted(hues, key=lambda hue: (hue + 30) % 360)
    shares = [float(text.partition(": ")[2].rstrip("%")) for text in seen]
    assert shares == pytest.approx([100 * found.shares()[hue] for hue in hues], rel=0.01)
    tab.value(f"{plot}.blur()")
    assert tab.value(readout) == ""
    left, top, width = tab.value(
        f"(() => {{ const b = {plot}.getBoundingClientRect(); return [b.left, b.top, b.width]; }})()"
    )
    tab.page.mouse.move(left + width * 90 / 360, top + 50)
    assert tab.value(readout).startswith("60°: ")
    tab.page.mouse.move(1, 1)
    assert tab.value(readout) == ""


@needs_browser
def test_command_is_copied(tab, files):
    tab.open(files / "hostile.html")
    tab.value("document.getElementById('copy').scrollIntoView({block: 'center'})")
    tab.value("void (navigator.clipboard.writeText = async (text) => { window.copied = text; })")
    tab.value("document.getElementById('copy').focus()")
    tab.page.keyboard.press("Enter")
    assert tab.value("window.copied") == Page(PAGES["hostile"]).texts["code"]
    assert tab.value("document.getElementById('copied').textContent") == "Copied"
    # Where that is not allowed, at least it is selected.
    tab.value("void (navigator.clipboard.writeText = () => Promise.reject(new Error('no')))")
    tab.value("document.getElementById('copied').textContent = ''")
    tab.page.keyboard.press("Enter")
    assert tab.value("getSelection().toString()") == Page(PAGES["hostile"]).texts["code"]
    assert tab.value("document.getElementById('copied').textContent") != ""


BOXES = """
['before', 'after'].map((kind) => {
  const figure = document.querySelector(`.${kind}`), box = figure.getBoundingClientRect();
  return [box.left, box.top, box.right, box.bottom, getComputedStyle(figure).clipPath];
})
"""


@needs_browser
def test_without_script_both_pictures_are_seen(tab, files):
    tab.open(files / "stack.html", script=False)
    try:
        before, after = tab.value(BOXES)
        assert after[1] >= before[3]
        assert before[4] == after[4] == "none"
        hidden = "[...document.querySelectorAll('.scripted, .handle, #split')].every((e) => !e.checkVisibility())"
        assert tab.value(hidden)
        assert tab.value("document.documentElement.scrollWidth") == 1280
    finally:
        tab.open(files / "stack.html")


@needs_browser
def test_printed_page_shows_both_pictures(tab, files):
    tab.open(files / "stack.html", dark=True)
    tab.page.emulate_media(media="print")
    try:
        before, after = tab.value(BOXES)
        assert after[0] >= before[2] - 1
        assert before[4] == after[4] == "none"
        assert tab.value("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert tab.value(FAINT)[1] == []
    finally:
        tab.page.emulate_media(media="screen")
    assert tab.page.pdf().startswith(b"%PDF")


@needs_browser
def test_every_control_can_be_reached_by_tab(tab, files):
    tab.open(files / "stack.html")
    wanted = tab.value(
        "[...document.querySelectorAll('a, button, input:not(:disabled), .plot, pre')].length"
    )
    tab.value("window.reached = new Set(), null")
    without_ring = []
    for _ in range(wanted):
        tab.page.keyboard.press("Tab")
        name, ring = tab.value(
            "(() => { const e = document.activeElement, s = getComputedStyle(e); reached.add(e);"
            "return [e.id || e.tagName, s.outlineStyle === 'solid' && parseFloat(s.outlineWidth) >= 2]; })()"
        )
        assert name != "BODY"
        if not ring:
            without_ring.append(name)
    assert tab.value("reached.size") == wanted
    assert without_ring == []


def test_browser_is_looked_for_by_its_names(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert browser.chromium() is None
    command = tmp_path / "google-chrome"
    command.write_text("#!/bin/sh\n")
    command.chmod(0o755)
    assert Path(browser.chromium() or "") == command
