"""Pages that are written from the code say what the code says."""

import re
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path

from farfield.settings import Settings

ROOT = Path(__file__).parents[2]


def test_the_data_model_page_is_what_the_dataclasses_say():
    checked = subprocess.run([sys.executable, ROOT / "infra/docs/data_model.py", "--check"], check=False)
    assert checked.returncode == 0, "run `python infra/docs/data_model.py`"


def test_the_settings_page_names_every_setting():
    keys = set()
    for field in fields(Settings):
        inner = field.default_factory() if callable(field.default_factory) else None
        keys |= {f"{field.name}.{f.name}" for f in fields(inner)} if is_dataclass(inner) else {field.name}
    named = set(re.findall(r"^\| `([a-z_.]+)` \|", (ROOT / "docs/settings.md").read_text(), flags=re.M))
    assert named == keys


def test_links_between_pages_lead_somewhere():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    links = [(page, link) for page in pages for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text())]
    assert not [(page.name, link) for page, link in links if "://" not in link and not (page.parent / link).exists()]
