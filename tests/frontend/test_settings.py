"""Every setting stands in the reference, with its default."""

from dataclasses import fields
from pathlib import Path

from vislam.frontend.settings import FrontEndConfig

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "front_end.md"


def test_the_page_has_every_setting_with_its_default():
    text = PAGE.read_text(encoding="utf-8")
    config = FrontEndConfig()
    for item in fields(FrontEndConfig):
        value = getattr(config, item.name)
        told = str(value).lower() if isinstance(value, bool) else str(value)
        assert f"| `{item.name}` | `{told}` |" in text
