#!/usr/bin/env python3
"""Counts the tuned numbers of the detection: settings, tuples among them, constants, and numbers in function bodies.

count_settings.py [-v] [FOLDER...]; without folders those of detection and views. Numbers other than 0, 1, 2 and 0.5 count.
Comments, texts and unit tests do not. Standard library only.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ["crates/measure/src/detect", "crates/measure/src/view"]
PLAIN = {0.0, 1.0, 2.0, 0.5}
NUMBER = re.compile(r"(?<![\w.#])(\d[\d_]*(?:\.\d+)?(?:e-?\d+)?)(?:_?(?:f32|f64|[iu](?:8|16|32|64|size)))?(?![\w])")
SETTING = re.compile(r"^\s*(\w+): ([^=;{}]+) = (.+?),$", re.M)
CONSTANT = re.compile(r"\bconst ([A-Z_0-9]+): [^=;]+(?:;[^=]*)?=[^;]*;", re.S)


def code(text):
    """The text without unit tests, comments and texts."""
    text = text.split("#[cfg(test)]\nmod tests")[0]
    text = re.sub(r"//[^\n]*", "", text)
    return re.sub(r'"(?:[^"\\]|\\.)*"', '""', text)


def blocks(text):
    """The bodies of `numbers!`, and the text without them."""
    bodies = []
    while (start := re.search(r"(?<!macro_rules! )\bnumbers! \{", text)) is not None:
        depth, end = 1, start.end()
        while depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        bodies.append(text[start.end() : end - 1])
        text = text[: start.start()] + text[end:]
    return bodies, text


def main():
    verbose = "-v" in sys.argv[1:]
    folders = [a for a in sys.argv[1:] if a != "-v"] or FOLDERS
    settings, constants, numbers = [], [], []
    for folder in folders:
        for file in sorted((ROOT / folder).rglob("*.rs")):
            place = str(file.relative_to(ROOT))
            bodies, text = blocks(code(file.read_text()))
            settings += [(place, m[1], m[2]) for body in bodies for m in SETTING.finditer(body)]
            constants += [(place, m[1]) for m in CONSTANT.finditer(text)]
            text = CONSTANT.sub("", text)
            numbers += [(place, m[1]) for m in NUMBER.finditer(text) if float(m[1].replace("_", "")) not in PLAIN]
    tuples = [s for s in settings if s[2].startswith("(")]
    if verbose:
        for name, rows in [("setting", settings), ("constant", constants), ("number", numbers)]:
            print("\n".join(f"{name} {' '.join(row)}" for row in rows))
    print(f"settings {len(settings)}, tuples among them {len(tuples)}, constants {len(constants)}, numbers in bodies {len(numbers)}")


if __name__ == "__main__":
    main()
