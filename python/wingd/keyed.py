"""Trees of keyed files of other programs: YAML, OpenCV's JSON and XML, and mrcal's literals, each value with its line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

from wingd import WingdError
from wingd.textfiles import fault, parse_number, read_text

#: Largest number of values of a file: a calibration has some hundreds, but a few lines of YAML can expand to millions.
MAX_NODES = 200_000
MAX_DEPTH = 64
#: Largest file, bytes.
MAX_BYTES = 1 << 22


@dataclass(frozen=True)
class Node:
    """Value of a keyed file.

    Attributes
    ----------
    file, line
        Place of the value.
    value
        Text of a number or word, list of nodes, or list of pairs of key and node.
    tag
        Type written before it, such as ``!!opencv-matrix``.
    """

    file: Path
    line: int
    value: str | list[Node] | list[tuple[str, Node]]
    tag: str = ""

    def fault(self, key: str, problem: str, remedy: str) -> WingdError:
        """Create the error of this value."""
        return fault(self.file, problem, remedy, line=self.line, key=key)

    @property
    def entries(self) -> list[tuple[str, Node]]:
        """Keys with their values; empty for other values."""
        return [e for e in self.value if isinstance(e, tuple)] if isinstance(self.value, list) else []

    @property
    def text(self) -> str | None:
        """Number or word as text."""
        return self.value if isinstance(self.value, str) else None

    def get(self, key: str) -> Node | None:
        """Return the value of a key, in upper or lower case: programs have changed it between versions."""
        found = [(k, node) for k, node in self.entries if k.lower() == key.lower()]
        if len(found) > 1:
            raise found[1][1].fault(found[1][0], "occurs twice", "keep the valid one")
        return found[0][1] if found else None

    def require(self, key: str, remedy: str) -> Node:
        """Return the value of a required key."""
        node = self.get(key)
        if node is None:
            raise self.fault(key, "is missing", remedy)
        return node

    def number(self, key: str) -> float:
        """Return a finite number."""
        if self.text is None:
            raise self.fault(key, "has a list or keys instead of a number", "give a number")
        number = parse_number(self.text.strip())
        if number is None:
            words = self.text.split()
            if len(words) > 1 and all(parse_number(word) is not None for word in words):
                problem = f"has {len(words)} numbers without commas between them"
                raise self.fault(key, problem, "write commas between the numbers")
            raise self.fault(key, f'"{self.text[:40]}" is not a finite number', "give a decimal number with a point")
        return number

    def numbers(self, key: str) -> list[float]:
        """Return the finite numbers of a list, of a list of rows, or of a single value."""
        if self.entries:
            raise self.fault(key, "has keys, not numbers", "give a list of numbers")
        if isinstance(self.value, str):
            return [self.number(key)]
        items = [item for item in self.value if isinstance(item, Node)]
        rows = all(isinstance(item.value, list) and not item.entries for item in items)
        return [n for item in items for n in (item.numbers(key) if rows else [item.number(key)])]


def parse_keyed(file: Path, syntax: str) -> Node:
    """Parse a file into a tree.

    Parameters
    ----------
    file
        Path of the file.
    syntax
        ``yaml``, ``json`` (with the comments that OpenCV writes), ``xml`` of OpenCV, or ``literal`` of mrcal.

    Raises
    ------
    WingdError
        The file violates its syntax, has a key twice or too many values.
    """
    text = read_text(file, MAX_BYTES)
    try:
        if syntax == "xml":
            return _parse_xml(file, text)
        # mrcal writes Python literals: lists, texts in quotes and comments are those of YAML, but bytes are not.
        text = re.sub(r"""\bb(['"])(?:[^'"\\\n]|\\.)*\1""", "''", text) if syntax == "literal" else text
        return _parse_yaml(file, text, syntax == "json")
    except (RecursionError, MemoryError):
        raise fault(file, f"is more than {MAX_DEPTH} levels deep", "name a camera file") from None


class _Builder:
    """Counts values and levels, and refuses keys that occur twice."""

    def __init__(self, file: Path) -> None:
        self.file, self.count = file, 0

    def visit(self, line: int, depth: int) -> None:
        self.count += 1
        if self.count > MAX_NODES:
            raise fault(self.file, f"has more than {MAX_NODES} values", "name a camera file", line=line)
        if depth > MAX_DEPTH:
            raise fault(self.file, f"is more than {MAX_DEPTH} levels deep", "name a camera file", line=line)

    def map(self, line: int, entries: list[tuple[str, Node]], tag: str = "") -> Node:
        seen = set()
        for key, node in entries:
            if key in seen:
                raise node.fault(key, "occurs twice", "keep the valid one")
            if key == "<<":
                raise node.fault(key, "merges keys from elsewhere, which is not supported", "write the merged keys out")
            seen.add(key)
        return Node(self.file, line, list(entries), tag)


def _parse_yaml(file: Path, text: str, is_json: bool) -> Node:
    try:
        import yaml
    except ImportError:
        raise WingdError("YAML and JSON need PyYAML; install it: pip install 'wingd[vision]'") from None
    if is_json:
        # Comments from // to the end of the line, outside of quotes.
        text = re.sub(r'("(?:[^"\\\n]|\\.)*")|//[^\n]*', lambda m: m[1] or "", text)
    # The first line of OpenCV's files is not YAML; as a comment, line numbers do not change.
    text = re.sub(r"\A%YAML:", "#YAML:", text)
    loader = yaml.SafeLoader(text)
    documents, build = [], _Builder(file)
    try:
        while loader.check_node():
            document = loader.get_node()
            # `rostopic echo` ends its output with `---`, which begins an empty document.
            if not (isinstance(document, yaml.ScalarNode) and document.value in ("", "~")):
                documents.append(document)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        cause = getattr(error, "problem", None) or str(error)
        remedy = "write it as YAML: keys aligned, blanks instead of tabs, lists in brackets or with dashes"
        raise fault(file, f"is not YAML ({cause})", remedy, line=mark.line + 1 if mark else 0) from None
    if not documents:
        raise fault(file, "is empty", "export it again")
    if len(documents) > 1:
        line = documents[1].start_mark.line + 1
        raise fault(file, "has several documents (---)", "keep the document of the camera", line=line)

    def convert(node: Any, depth: int) -> Node:
        line = node.start_mark.line + 1
        build.visit(line, depth)
        tag = "" if node.tag.startswith("tag:yaml.org,2002:") and "opencv" not in node.tag else node.tag
        if isinstance(node, yaml.MappingNode):
            entries = []
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode):
                    raise fault(file, "has a list as a key", "give every value a name as its key", line=line)
                entries.append((key.value, convert(value, depth + 1)))
            return build.map(line, entries, tag)
        if isinstance(node, yaml.SequenceNode):
            return Node(file, line, [convert(item, depth + 1) for item in node.value], tag)
        return Node(file, line, node.value, tag)

    return convert(documents[0], 0)


def _parse_xml(file: Path, text: str) -> Node:
    """Parse OpenCV's FileStorage: elements are keys, lists are words between blanks or elements named ``_``."""
    if re.search(r"<!(DOCTYPE|ENTITY)", text):
        raise fault(file, "defines entities, which OpenCV's files do not", "export it again")
    build = _Builder(file)
    parser = expat.ParserCreate()
    stack: list[tuple[str, str, int, list[tuple[str, Node]], list[str]]] = []
    roots: list[Node] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        build.visit(parser.CurrentLineNumber, len(stack))
        if not stack and name != "opencv_storage":
            problem, remedy = f"begins with <{name}>", "give the XML of OpenCV's FileStorage: <opencv_storage>"
            raise fault(file, problem, remedy, line=parser.CurrentLineNumber)
        stack.append((name, attributes.get("type_id", ""), parser.CurrentLineNumber, [], []))

    def end(_: str) -> None:
        name, tag, line, children, texts = stack.pop()
        words = " ".join("".join(texts).split())
        if not children:
            is_quoted = len(words) > 1 and words[0] == words[-1] == '"'
            is_list = not is_quoted and " " in words
            for _word in words.split() if is_list else ():
                build.visit(line, len(stack) + 1)
            value = (
                [Node(file, line, w) for w in words.split()] if is_list else words.strip('"') if is_quoted else words
            )
            node = Node(file, line, value, tag)
        elif all(key == "_" for key, _ in children):
            node = Node(file, line, [child for _, child in children], tag)
        else:
            node = build.map(line, children, tag)
        if stack:
            stack[-1][3].append((name, node))
        else:
            roots.append(node)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = lambda data: stack[-1][4].append(data) if stack else None
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        cause = str(error).split(":")[0]
        raise fault(file, f"is not XML ({cause})", "export it again", line=error.lineno) from None
    return roots[0]
