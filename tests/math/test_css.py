"""CSS colours: what is one, what light it is, and where an alpha is refused."""

import numpy as np
import pngfile
import pytest

from hpcomp.color.css import css_color, css_title
from hpcomp.errors import SettingError


def light(*codes):
    return pytest.approx([*pngfile.srgb_to_linear(np.array(codes) / 255)], abs=1e-12)


@pytest.mark.parametrize(
    ("text", "codes"),
    [
        ("#f80", (255, 136, 0)),
        ("f80", (255, 136, 0)),
        ("#FF8800", (255, 136, 0)),
        ("ff8800", (255, 136, 0)),
        ("#f80f", (255, 136, 0)),
        ("#ff8800FF", (255, 136, 0)),
        ("orange", (255, 165, 0)),
        ("CornflowerBlue", (100, 149, 237)),
        ("grey", (128, 128, 128)),
        ("gray", (128, 128, 128)),
        ("tan", (210, 180, 140)),
        ("cyan", (0, 255, 255)),  # four letters, but no digits
        ("lavender", (230, 230, 250)),  # eight
        ("rebeccapurple", (102, 51, 153)),
    ],
)
def test_names_and_digits(text, codes):
    assert css_color(text, "tint") == light(*codes)


@pytest.mark.parametrize(
    ("text", "near"),
    [
        ("ornage", "orange"), ("lightblu", "lightblue"), ("#ggg", "orange"), ("#12345", "orange"),
        ("", "orange"), ("#", "orange"), ("##fff", "orange"), (" #fff", "orange"),
        ("#fff\n", "orange"), ("#-1-1-1", "orange"), ("٣٣٣", "orange"), ("#orange", "orange"),
    ],
)  # fmt: skip
def test_what_is_no_colour(text, near):
    with pytest.raises(SettingError) as error:
        css_color(text, "tint")
    assert str(error.value) == f"'{text}' is not a colour: write a CSS colour such as #ff8800 or {near}"


@pytest.mark.parametrize("use", ["background", "label", "tint"])
@pytest.mark.parametrize(
    ("text", "color"), [("#F808", "#f80"), ("ff880000", "#ff8800"), ("#ff8800fe", "#ff8800")]
)
def test_translucent_colours_are_refused(text, color, use):
    with pytest.raises(SettingError, match=rf"^'{text}' is translucent, but a {use} .*: write {color}$"):
        css_color(text, use)


def test_titles():
    texts = ["0F0", "#0f0", "Orange", "#E41A1C", "fade"]
    assert [css_title(text) for text in texts] == ["#0f0", "#0f0", "orange", "#e41a1c", "#fade"]


def test_every_byte_is_decoded_as_srgb():
    found = [css_color(f"#{code:02x}{code:02x}{code:02x}", "label")[0] for code in range(256)]
    assert np.abs(found - pngfile.srgb_to_linear(np.arange(256) / 255)).max() <= 1e-12
