"""Patterns of prose that hide the subject or the standard term, counted in code and pages.

The reference counts are those of commit c1eb8745 by the same expressions. For words that also have
a right sense (*place* a lesion, *number of* frames, *masks* of an image), `Pattern.wrong` matches
the uses to replace, and `Pattern.correct` the names and terms that contain such a use.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

GOAL = 0.02
"""Permitted fraction of the reference count."""

QUESTION = r"(What|How|Where|Which|Who|Whose|Why|When)\b"


@dataclass(frozen=True)
class Text:
    """Text of the repository in which patterns are counted.

    Attributes:
        root: Folder of the repository.
    """

    root: Path

    @cached_property
    def code(self) -> dict[Path, str]:
        """Python files of the package."""
        return _read((self.root / "src").rglob("*.py"))

    @cached_property
    def pages(self) -> dict[Path, str]:
        """Markdown pages: documentation, model cards and those of the root folder."""
        folders = (self.root / "docs", self.root / "weights")
        return _read([*self.root.glob("*.md"), *(p for f in folders for p in f.rglob("*.md"))])


@dataclass(frozen=True)
class Pattern:
    """One pattern of prose, as regular expressions without regard to case.

    Attributes:
        name: Number and short form.
        expression: Expression of all uses.
        reference: Counts in the package and the pages at commit c1eb8745.
        wrong: Expression of the uses to replace; empty if all are.
        wrong_reference: Number of uses to replace at commit c1eb8745; 0 if all are.
        correct: Expression of correct uses, which are names and terms; it may span more text.
    """

    name: str
    expression: str
    reference: tuple[int, int]
    wrong: str = ""
    wrong_reference: int = 0
    correct: str = ""

    def counts(self, text: Text) -> tuple[int, int]:
        """Counts of all uses in the package and in the pages."""
        code, pages = (_matches(self.expression, files) for files in (text.code, text.pages))
        return sum(1 for _ in code), sum(1 for _ in pages)

    def to_replace(self, text: Text) -> list[str]:
        """File, line and text of each use to replace."""
        uses = _matches(self.wrong or self.expression, text.code | text.pages, self.correct)
        return [f"{path.relative_to(text.root)}:{line}: {excerpt}" for path, line, excerpt in uses]

    @property
    def goal(self) -> int:
        """Largest permitted number of uses to replace."""
        return int(GOAL * (self.wrong_reference or sum(self.reference)))


def _read(paths: Iterator[Path] | list[Path]) -> dict[Path, str]:
    return {path: path.read_text(encoding="utf-8") for path in sorted(paths)}


def _matches(
    expression: str, files: dict[Path, str], correct: str = ""
) -> Iterator[tuple[Path, int, str]]:
    """File, line and text of all matches that do not lie within a match of `correct`."""
    compiled, kept = (re.compile(text, re.I | re.M) for text in (expression, correct or r"(?!)"))
    for path, text in files.items():
        lines, spans = text.splitlines(), [match.span() for match in kept.finditer(text)]
        for match in compiled.finditer(text):
            if not any(a <= match.start() and match.end() <= b for a, b in spans):
                line = text.count("\n", 0, match.end())
                yield path, line + 1, lines[line].strip()


_LIMIT = r"""(?-i:\b_?(MOST|LEAST|LARGEST)_\w+|(\"\"\"|\# |: )(Most|Least|Largest|Fewest) \w+)"""
_PLACE = (
    r"\b(the|a|its|each|every|this|that|one|no|first|last|same|other|another|their|of) places?\b"
    r"|\b\w*_?places?(?= =| in |\[|: (int|str))"
)
_NUMBER = (
    r"\bnumbered\b|\bby (its )?number\b|\bthe number(?! of)\b|\b\w*(?<!\w)numbers?(?= =|\[|: int)"
)
_FIGURE = r"(?<![.\w\"])figures?\b(?![.(=\"])"
_RESULT = r"^[ \t]*(found|told|said|shown|places|chance)\b(: [^=\n]+)? = |(?-i:\bclass Found\b)"
_LEARN = r"\blearn(s|ed|t)?\b(?! (more|how))(?<!vrcaps\.learn)(?<!\.learn)"
_TASK = r"[\"'`](masks|classes|masks-kinds)[\"'`]|\btrain (masks|classes)\b|\b(Mask|Class)Learner"
_HEADING = (
    r"(?-i:^##* ((Speed|Memory|Size|Masks|Designs) of|[A-Z]\w*(ed|en|ing|ade) by"
    r"|What|Where|Which|Who|How(?![- ]to))\b)"
)

# Correct uses, which keep their name.
_METHOD_BEGIN = r"(\bdef |[\w)\]]\.)begin\b|`(\w+\.)?begin`"
"""Public methods: `MotionSettings.begin`, `Reward.begin` and others."""
_METHOD_TELL = r"\.tell\("
"""Method of Python's files."""
_GUT_PLACE = r"\bself\._place\b|\bplace = arc_length / "
"""Places in the gut: that of the capsule on the map of the wall, and multiples of a length."""
_ELEMENT = (
    r"</?figure>|\bfigure (\{|img\b)|\bmake figures\b|\bfigure = (make_figure|import_extra)\("
)
"""HTML element for images with a caption, target of the Makefile, and figures of Matplotlib."""
_PARAMETER = r"^ +shown: \w+ \| None = None,$"
"""Parameter `shown` of motions: the model or organ that the views show."""
_EXTRA = (
    r"(import_extra|MissingExtraError)\([^)\n]*\"learn\"|\"torch\": \"learn\""
    r"|\[[\w,]*\blearn\b[\w,]*\]"
    r"|\"learn/\w+\"|`learn(\.\w+|/[\w/.]+)?`"
)
"""Extra of pyproject.toml, names of random streams, and the package `vrcaps.learn`."""
_LAYOUT = (
    r"layout\b.*[\"'`](masks|classes)[\"'`]|_MASKS = .*|`masks``?(?= (or|next))"
    r"|\b(getattr|require)\(\w+, \"classes\"|outside `classes`"
    r"|FORMER_TASKS = .*|Rename the tasks .*|Merge `metrics.classification` and `masks`"
)
"""Folders and layouts of images, the field `classes` of tasks, and former names."""

PATTERNS = (
    Pattern("P1 opening question word", rf'(?-i:"""{QUESTION})', (407, 0)),
    Pattern("P2 what is …", r"\bwhat (is|are|was|were|has|have|it|a|an|the)\b", (546, 123)),
    Pattern("P3 begin", r"\bbeg[iau]ns?\b", (294, 61), "", 306, _METHOD_BEGIN),
    Pattern("P4 go on", r"\b(go|goes|went|going|gone) on\b", (70, 44)),
    Pattern("P5 tell, told", r"\b(told|tells?)\b", (123, 48), "", 157, _METHOD_TELL),
    Pattern("P6 anew", r"\banew\b", (31, 17)),
    Pattern("P7 judge", r"\bjudg(e|es|ed|ing)\b", (47, 22)),
    Pattern("P8 of its own", r"\bof (its|their|one's) own\b", (60, 28)),
    Pattern("P9 most, least as limits", _LIMIT, (283, 0)),
    Pattern("P10 share of", r"\bshares? of\b", (90, 12)),
    Pattern("P11 place for index, slot", r"\bplaces?\b", (1126, 75), _PLACE, 408, _GUT_PLACE),
    Pattern("P12 number for index, ID", r"\bnumbers?\b(?! of)", (1370, 66), _NUMBER, 265),
    Pattern("P13 figure for value", r"\bfigures?\b", (173, 27), _FIGURE, 111, _ELEMENT),
    Pattern("P14 found as a result", r"\bfound\b", (756, 32), _RESULT, 260, _PARAMETER),
    Pattern("P15 beside", r"\bbeside\b", (148, 56)),
    Pattern("P16 learn for train", r"\blearn(s|ed|t|ing)?\b", (244, 87), _LEARN, 149, _EXTRA),
    Pattern("P17 masks, classes as tasks", r"\b(masks?|classes)\b", (407, 218), _TASK, 61, _LAYOUT),
    Pattern("P18 augmentation", "in other colors|parts of frames|changed at random", (3, 4)),
    Pattern("P19 …, too", r", too\b", (29, 28)),
    Pattern("P20 headings: X of Y", _HEADING, (3, 38)),
)
