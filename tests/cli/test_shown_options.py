"""Every command and option in the documentation and in the help is one that the programs accept."""

from __future__ import annotations

import dataclasses
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest

from vrcaps import cli
from vrcaps.cli.record import Record
from vrcaps.core.errors import InputError
from vrcaps.learn.training import TrainSettings

ROOT = Path(__file__).parents[2]
PAGES = tuple(
    path
    for pattern in ("README.md", "CONTRIBUTING.md", "docs/**/*.md", "weights/*.md")
    for path in sorted(ROOT.glob(pattern))
)
PLACEHOLDER = re.compile(r"[A-Z][A-Z_]*(=[A-Z]+)?|…|<.*>|\.\.\.|\[.*\]?")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
MOTIONS = ("dynamics", "fly-through", "random-views", "replay")
OF_PLUGINS = {"position-table", "distance", "rest", "env.task=rest"}
"""Names that the guide to extensions registers; `docs/test_extending.py` runs its programs."""
OTHER_TOOLS = {"--logdir", "--continue"}
"""Options of tensorboard and of git."""


def shown(text: str) -> Iterator[str]:
    """Lines of blocks, with their continuation, and inline code."""
    for block in FENCE.finditer(text):
        yield from block[2].replace("\\\n", " ").splitlines()
    for code in INLINE.finditer(FENCE.sub("", text)):
        yield code[1]


def words_of(line: str) -> list[str]:
    """Words of a command, without comments and what pipes or repeats it."""
    try:
        words = shlex.split(line.strip().removeprefix("$ "), comments=True)
    except ValueError:  # a text with an apostrophe
        return []
    ends = [k for k, word in enumerate(words) if word in ("|", "&&", ";", ">")]
    return words[: ends[0]] if ends else words


def helps() -> Iterator[tuple[str, str]]:
    """Verb and docstring of each command."""
    for path, (module, noun, _) in cli._all_verbs().items():
        yield path, cli._command(module, path, noun).__doc__ or ""


def vrcaps_commands() -> Iterator[Any]:
    """Commands of vrcaps that a page or a help shows."""
    for page in PAGES:
        for line in shown(page.read_text("utf-8")):
            words = words_of(line)
            if words[:1] == ["vrcaps"] and len(words) > 1 and not OF_PLUGINS & {*words}:
                yield pytest.param(words[1:], id=f"{page.name}: {line.strip()[:60]}")
    for path, text in helps():
        lines = re.sub(r"\n {2,}--", " --", text).splitlines()
        for words in (words_of(line) for line in lines if line.strip().startswith("vrcaps ")):
            yield pytest.param(words[1:], id=f"help of {path}: {' '.join(words)[:60]}")


@pytest.mark.slow
@pytest.mark.parametrize("words", tuple(vrcaps_commands()))
def test_a_shown_command_is_accepted(words: list[str], tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    if any(PLACEHOLDER.fullmatch(word) for word in words) or not any(w[0] == "-" for w in words):
        verbs = [" ".join(words[:count]) for count in (1, 2)]
        is_general = len(words) > 1 and PLACEHOLDER.fullmatch(words[1]) and words[0] in cli._GROUPS
        assert is_general or {*verbs} & {*cli._all_verbs(), *cli._GROUPS}
        options = [word.partition("=")[0] for word in words if word.startswith("--")]
        assert {*options} <= {*all_options(), "--help"}
        return
    if "--help" in words:
        cli.check_verb(words[:-1], cli._all_verbs(), {})
        return
    for word in words[1:]:
        if word.endswith((".toml", ".json")) and "=" not in word:  # files that are read
            (tmp_path / word).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / word).touch()
    assert is_accepted(*words)


@cache
def is_accepted(*words: str) -> bool:
    """Whether a command is parsed; files that it reads exist. Many pages show the same commands."""
    return cli._parse(words) is not None


def _nested(declared: Any) -> Iterator[Any]:
    """Dataclasses in a type."""
    if dataclasses.is_dataclass(declared):
        yield declared
    if get_origin(declared) is Annotated:
        yield from _nested(get_args(declared)[0])


def _options_of(command: Any) -> Iterator[str]:
    hints = get_type_hints(command, include_extras=True)
    for f in dataclasses.fields(command):
        inner = list(_nested(hints[f.name]))
        name = f.name.replace("_", "-")
        if inner:
            yield from (option for one in inner for option in _options_of(one))
        else:
            yield f"--no-{name}" if f.default is True else f"--{name}"


@cache
def all_options() -> dict[str, set[str]]:
    """Verbs that have each option."""
    found: dict[str, set[str]] = {}
    for path, (module, noun, _) in cli._all_verbs().items():
        for option in _options_of(cli._command(module, path, noun)):
            found.setdefault(option, set()).add(path)
    return found


@cache
def script_options() -> frozenset[str]:
    """Options of all scripts."""
    text = "".join(path.read_text("utf-8") for path in script_files())
    return frozenset(re.findall(r'"(--[a-z][\w-]*)"', text))


def script_files() -> list[Path]:
    return [path for folder in ("benchmarks", "examples", "docs") for path in
            sorted((ROOT / folder).rglob("*.py"))]  # fmt: skip


def inline_options() -> Iterator[Any]:
    for page in PAGES:
        for code in INLINE.finditer(FENCE.sub("", page.read_text("utf-8"))):
            words = words_of(code[1])
            if words and words[0].startswith("--"):
                yield pytest.param(words, id=f"{page.name}: {code[1][:60]}")


@pytest.mark.slow
@pytest.mark.parametrize("words", tuple(inline_options()))
def test_an_option_in_a_text_exists_and_takes_its_value(words: list[str]) -> None:
    """Options of `record` with their values give a scenario; others exist in some program."""
    names = {word.partition("=")[0] for word in words if word.startswith("--")}
    known = all_options()
    others = {*script_options(), *OTHER_TOOLS, "--help"}
    missing = names - {*known} - others
    assert not missing
    verbs = set.intersection(*(known.get(name, set()) for name in names))
    of_record = "record" in verbs and verbs <= {"record", "cockpit"}
    is_whole = len(words) > 1 and not any(PLACEHOLDER.fullmatch(word) for word in words)
    if of_record and is_whole:
        assert resolves(*words)
    elif "--set" in names and is_whole:
        settings = [word.partition("=")[0] for word in words if "=" in word and word[0] != "-"]
        training = {f.name for f in dataclasses.fields(TrainSettings)} | {"env", "learner"}
        assert {name.partition(".")[0] for name in settings} <= training or resolves(*words)


@cache
def resolves(*words: str) -> bool:
    """Return whether options of `record` give a scenario, for some motion or lens effect."""
    reasons = []
    # Most options in texts are of simulations, so the default motion is tried last.
    for more in (*(["--motion", kind] for kind in MOTIONS), []):
        command = cli._parse(["record", "--out", "o", *more, *words])
        assert isinstance(command, Record)
        try:
            command.resolved()
        except InputError as error:
            reasons.append(str(error))
        else:
            return True
    raise AssertionError(reasons[0])


def script_commands() -> Iterator[Any]:
    for page in PAGES:
        for line in shown(page.read_text("utf-8")):
            words = words_of(line)
            if words[:1] == ["python"] and len(words) > 1 and words[1].endswith(".py"):
                yield pytest.param(words[1:], id=f"{page.name}: {line.strip()[:60]}")


@pytest.mark.parametrize("words", tuple(script_commands()))
def test_a_shown_script_exists_and_has_its_options(words: list[str]) -> None:
    path = ROOT / words[0]
    assert path.is_file()
    options = {word.partition("=")[0] for word in words[1:] if word.startswith("--")}
    text = "".join(one.read_text("utf-8") for one in with_imports(path))
    own = {*re.findall(r'"(--[\w-]+)"', text)}
    own |= {
        f"--{name.replace('_', '-')}" for name in re.findall(r"^    (\w+): ", text, re.MULTILINE)
    }
    assert options <= own


def with_imports(path: Path) -> set[Path]:
    """A script and the scripts beside it that it imports."""
    found, new = set(), {path}
    while new:
        found |= new
        names = {
            name
            for one in new
            for name in re.findall(
                r"^\s*(?:from|import) (\w+)", one.read_text("utf-8"), re.MULTILINE
            )
        }
        beside = {path.with_name(f"{name}.py") for name in names}
        new = {one for one in beside if one.is_file()} - found
    return found
