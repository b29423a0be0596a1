"""Commands and options of the package that the pages name exist; the program's test covers its own."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
from functools import cache
from pathlib import Path

import pytest

from wingd.commands import COMMANDS

ROOT = Path(__file__).parents[2]


def lines() -> list[tuple[str, str, list[str]]]:
    """Page, command and words of each line of code that calls a command of the package."""
    found = []
    for page in sorted({ROOT / "README.md", *ROOT.glob("docs/**/*.md")}):
        if "decisions" in page.parts:
            continue
        text = page.read_text()
        code = [line for block in re.findall(r"^```\w*\n(.*?)^```$", text, re.M | re.S) for line in block.splitlines()]
        code += re.findall(r"`([^`\n]+)`", text)
        for line in code:
            match = re.match(r"(?:\$ )?wingd[ -]([a-z-]+)\b(.*)", line)
            if match and match[1] in COMMANDS and not line.endswith(" "):
                found.append(
                    (f"{page.relative_to(ROOT)}: {line}", match[1], match[2].split(" | ")[0].split("#")[0].split())
                )
    return found


@cache
def help_of(command: str, sub: str | None) -> str:
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.suppress(SystemExit):
        importlib.import_module(COMMANDS[command]).main([*([sub] if sub else []), "--help"])
    return output.getvalue()


def test_commands_and_options_that_the_pages_name_exist():
    pytest.importorskip("duckdb")
    wrong, checked = [], 0
    for place, command, words in lines():
        if importlib.util.find_spec(COMMANDS[command]) is None:
            continue
        options = {word.split("=")[0].strip("[]()") for word in words if word.strip("[(").startswith("--")}
        sub = words[0] if command == "fleet" and words and re.fullmatch("[a-z]+", words[0]) else None
        text = help_of(command, sub)
        known = set(re.findall(r"--[a-z0-9-]+", text))
        checked += len(options)
        wrong += [f"{place}: no option {option}" for option in sorted(options - known - {"--"})]
        if not text:
            wrong.append(f"{place}: no such command")
    assert not wrong, "\n".join(wrong)
    assert checked > 20


def test_the_gallery_is_what_its_command_writes():
    from demo.gallery import page

    text = (ROOT / "docs" / "gallery.md").read_text()
    assert text == page(), "run `make gallery`"
    figures = [ROOT / "docs" / name for name in re.findall(r"!\[.*?\]\((.*?)\)", text)]
    assert len(figures) == 9 and all(figure.stat().st_size < 60_000 for figure in figures)
