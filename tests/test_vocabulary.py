"""Public names, keys, columns and flags use the field's terms (docs/reference/glossary.md)."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import vrcaps
from vrcaps import cli

PACKAGE = Path(vrcaps.__file__).parent
ROOT = Path(__file__).resolve().parents[1]
FILES = sorted([*PACKAGE.rglob("*.py"), *PACKAGE.glob("*.pyi")])
CRATE = sorted((ROOT / "rust" / "src").rglob("*.rs"))

_WORDS = """
    afloat beneath bends bogies bounced calibre calm carriage carrier centre centres coat colour
    colours commander crowd driven figures gi glow haemorrhage held leader learnt mend mended
    patience pilot press printed pulled quick rail room share shares sick stations steered stir
    stirred swarm tabled taken thinned touched way ways wear wish wobble worn yields
"""
BANNED_WORDS = frozenset(_WORDS.split())
"""Words that occur in no public name; each has a standard term."""

_NAMES = """
    aim_magnet film_um front_depth front_instance front_label lead lead_on light_seed load_arm
    load_device load_magnet load_organ make_way takes_means
"""
BANNED_NAMES = frozenset(_NAMES.split())
BANNED_IN = {"camera_pipeline": {"grade", "grades"}, "lumen": {"grade", "grades"}}
"""Words that are right elsewhere: a polyp and a magnet have a grade, an effect has a severity."""

IN_CORE = {"world": {"press", "shares", "touched", "way"}}
"""Words that names of a folder of the core may have; its Python names are in `_core.pyi`."""

ALLOWED = {"cli/benchmarks": {"quick"}, "formats/detection/coco": {"crowd"}}
"""`vrcaps bench --quick` measures little; a crowd is COCO's term for many of a kind."""

VERBS = (
    *("record", "demo", "check", "doctor"),
    *("organ inspect", "organ make", "organ list", "organ from-ct", "bench render"),
)

TERMS = {
    "src/vrcaps/render": "radiosity|path tracing|subsurface scattering|refraction|mucus film"
    "|global illumination|narrow-band imaging|optical flow",
    "src/vrcaps/tissue": "Winkler foundation|finite element|peristalsis|viscous",
    "src/vrcaps/camera_pipeline": "rolling shutter|chromatic aberration|vignetting|demosaic|defocus"
    "|exposure|severity",
    "src/vrcaps/actuation": "inverse kinematics|workspace|wrench|joystick",
    "src/vrcaps/magnet": "dipole|flux density",
    "src/vrcaps/lesion": "polyp|ulcer|colitis|angioectasia|diverticulum|stricture",
    "src/vrcaps/motion": "centerline|rollout",
    "rust/src/render": "form factor|radiosity|Russian roulette|BSDF|wavefront|importance sampling",
    "rust/src/world": "broad phase|contact|Winkler",
    "docs": "global illumination|radiosity|form factor|path tracing|subsurface scattering"
    "|refraction"
    "|semantic label|Winkler foundation|finite elements|rolling shutter|photometric calibration"
    "|narrow-band imaging|optical flow|inverse kinematics|arc length|severity|bowel preparation",
}
"""Terms that a reader searches for, and where they must be found."""


def words(name: str) -> set[str]:
    """Lower-case words of a snake_case, kebab-case or CamelCase name."""
    parts = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return {word.lower() for word in re.split(r"[_\W]+", parts) if word}


def banned(names: Iterable[str], path: str = "") -> list[str]:
    """Names with a word that is banned where they stand."""
    here = set(BANNED_WORDS).union(*(w for at, w in BANNED_IN.items() if path.startswith(at)))
    here.difference_update(*(w for at, w in ALLOWED.items() if path.startswith(at)))
    return sorted({n for n in names if words(n) & here or n in BANNED_NAMES})


def is_public(name: str) -> bool:
    return not name.startswith("_") or name in ("__init__", "__call__")


def public_names(tree: ast.AST) -> Iterator[str]:
    """Functions, classes, fields, constants and arguments of a module that have no underscore."""
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.FunctionDef(name=name, args=args) if is_public(name):
                yield name
                yield from (a.arg for a in [*args.posonlyargs, *args.args, *args.kwonlyargs])
            case ast.ClassDef(name=name) if is_public(name):
                yield name
                yield from public_names(node)
            case ast.AnnAssign(target=ast.Name(id=name)) if is_public(name):
                yield name
            case ast.Assign(targets=targets):
                names = (t.id for t in targets if isinstance(t, ast.Name))
                yield from filter(is_public, names)


def keys(tree: ast.AST) -> Iterator[str]:
    """Texts that look like a name: columns, keys of files, labels."""
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and re.fullmatch(r"[a-z][a-z0-9]*([_-][a-z0-9]+)+", text):
            yield text


def test_the_words_of_a_name() -> None:
    assert words("MakeWay") == {"make", "way"}
    assert words("image_speed_px") == {"image", "speed", "px"}
    assert banned(["wall_share", "shared", "--front-way"]) == ["--front-way", "wall_share"]
    assert banned(["grade"], "lumen/contents.py") and not banned(["grade"], "lesion/polyp.py")


def test_public_names_and_keys_use_standard_terms() -> None:
    found = {}
    for path in FILES:
        where, tree = path.relative_to(PACKAGE).as_posix(), ast.parse(path.read_text())
        names = [*public_names(tree), *keys(tree), *where.removesuffix(".py").split("/")]
        if hits := banned(names, where):
            found[where] = hits
    assert not found


def test_public_names_of_the_core_use_standard_terms() -> None:
    kinds = "fn|struct|enum|const|static|trait|mod|type"
    name = re.compile(rf"\bpub(?:\([^)]*\))? (?:(?:{kinds}) )?(\w+)")
    found = {}
    for path in CRATE:
        where = path.relative_to(ROOT / "rust" / "src").as_posix()
        names = [*name.findall(path.read_text()), *where.removesuffix(".rs").split("/")]
        here = IN_CORE.get(where.split("/")[0], set())
        if hits := [name for name in banned(names, where) if not words(name) & here]:
            found[where] = hits
    assert not found


@pytest.mark.parametrize("verb", VERBS)
def test_flags_use_standard_terms(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main([*verb.split(), "--help"])
    flags = set(re.findall(r"--[a-z][a-z-]+", capsys.readouterr().out))
    assert "--help" in flags
    assert not banned(flags, "cli/benchmarks" if verb.startswith("bench") else "")


@pytest.mark.parametrize("folder", TERMS)
def test_terms_can_be_found_where_they_belong(folder: str) -> None:
    files = [p for p in sorted((ROOT / folder).rglob("*")) if p.suffix in (".py", ".rs", ".md")]
    text = " ".join(re.sub(r"[\s/!\-–_]+", " ", path.read_text()).lower() for path in files)
    missing = [t for t in TERMS[folder].split("|") if t.lower().replace("-", " ") not in text]
    assert not missing


OPENING = re.compile(r"(What|How|Where|Which|Who|Whose|Why|When)\b(?![- ]to\b)")
"""First words of a sentence that hide its subject."""
QUESTION = re.compile(rf"[\"'][\s\\]*{OPENING.pattern}")
"""The same at the beginning of a string in a Python file."""
IDIOMS = re.compile(
    r"\banew\b|\b(go|goes|going|went|gone) on\b|\bbeg[iau]ns?\b(?!:)|\b(told|tells?)\b"
    r"|\bjudg(e|es|ed|ing)\b|\bshares? of\b|\bof (its|their|one's) own\b|\bbeside\b"
    r"|\bwhat (is|are|was|were|has|have|it|a|an|the)\b"
)
"""Idioms with a term in the glossary: again, resume, initialize, report, evaluate, fraction,
separate, next to, and a noun."""

RAISING = re.compile(r"(\w+(Error|Warning)|require\w*|warn|_stop)$")
"""Functions and classes whose text arguments are messages."""


def unclear(text: str) -> bool:
    """Return whether a text opens with a question word or contains an idiom; code is ignored."""
    prose = "\n".join(line for line in text.splitlines() if "runs/" not in line)
    return bool(OPENING.match(text) or IDIOMS.search(re.sub(r"`[^`]*`", "`x`", prose)))


def docstrings(tree: ast.AST) -> Iterator[str]:
    """Docstrings of a module, its classes, functions, fields and constants."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for first, second in pairwise(body if isinstance(body, list) else ()):
            match first, second:
                case ast.Assign() | ast.AnnAssign(), ast.Expr(value=ast.Constant(value=str(text))):
                    yield inspect.cleandoc(text)
        kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        if isinstance(node, kinds) and (doc := ast.get_docstring(node)):
            yield doc


def questions(path: Path) -> list[str]:
    """Docstrings of a file that open with a question word; most files need not be parsed."""
    source = path.read_text(encoding="utf-8")
    if not QUESTION.search(source):
        return []
    texts = docstrings(ast.parse(source))
    return [f"{path}: {text}" for text in texts if OPENING.match(text)]


def plain_text(node: ast.AST) -> str:
    """Text of a string or f-string, with X for each inserted value; empty for other nodes."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=values):
            return "".join(plain_text(value) or "X" for value in values)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return plain_text(left) + plain_text(right)
    return ""


def messages(tree: ast.AST) -> Iterator[str]:
    """Texts of errors and warnings: arguments of `raise NameError(…)` and `require(…)`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and RAISING.search(ast.unparse(node.func)):
            yield from filter(None, map(plain_text, node.args))


COMMENT = re.compile(
    r"(?m)(?:^[ \t]*(//[/!]?)(?!/)(?:[ \t].*)?\n)(?:^[ \t]*\1(?!/)(?:[ \t].*)?\n)*"
)
"""Comment lines of one kind in Rust that follow one another."""


def unclear_comments(source: str) -> list[str]:
    """Unclear comments of a Rust file; those of code may open with a question word."""
    found = []
    for comment in COMMENT.finditer(source):
        text = " ".join(re.sub(r"(?m)^[ \t]*//[/!]?", "", comment[0]).split())
        is_doc = comment[1] != "//"
        if unclear(text if is_doc else f"// {text}") or (is_doc and text.startswith("Whether ")):
            found.append(text)
    return found


def headings(page: str) -> Iterator[str]:
    """Headings of a Markdown page."""
    code = False
    for line in page.splitlines():
        code ^= line.lstrip().startswith("```")
        if not code and (match := re.match(r"#+ (.+)", line)):
            yield match[1]


def area(path: Path) -> str:
    """Package of a source file, or path of a page."""
    if path.is_relative_to(PACKAGE):
        return path.relative_to(PACKAGE).parts[0]
    return path.relative_to(ROOT).as_posix()


def unclear_prose(path: Path) -> list[str]:
    """Unclear docstrings and messages of a source file, or headings of a page."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return [heading for heading in headings(text) if unclear(heading)]
    tree = ast.parse(text)
    return [prose for prose in (*docstrings(tree), *messages(tree)) if unclear(prose)]


PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


@pytest.mark.parametrize("name", sorted({area(path) for path in (*FILES, *PAGES)}))
def test_docstrings_messages_and_headings_state_their_subject(name: str) -> None:
    found = {
        path.name: texts
        for path in (*FILES, *PAGES)
        if area(path) == name and (texts := unclear_prose(path))
    }
    assert not found


def test_comments_of_the_core_state_their_subject() -> None:
    found = {
        path.relative_to(ROOT).as_posix(): texts
        for path in CRATE
        if (texts := unclear_comments(path.read_text(encoding="utf-8")))
    }
    assert not found


def test_docstrings_open_with_their_subject() -> None:
    assert not [text for path in FILES for text in questions(path)]


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["tests", "benchmarks", "docs", "examples"])
def test_docstrings_outside_the_package_open_with_their_subject(folder: str) -> None:
    assert not [text for path in (ROOT / folder).rglob("*.py") for text in questions(path)]


@pytest.mark.slow
@pytest.mark.parametrize("verb", sorted(cli._VERBS))
def test_help_states_its_subject(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main([*verb.split(), "--help"])
    text = capsys.readouterr().out
    assert "--help" in text
    assert not [line for line in text.splitlines() if unclear(line.strip(" │|"))]


@pytest.mark.parametrize("verb", sorted(cli._VERBS))
def test_summaries_of_verbs_state_their_subject(verb: str) -> None:
    assert not unclear(cli._VERBS[verb][2])


PLANTED = (
    "What one capsule is about.",
    "How near an image is to its original.",
    "Where points lie best on a surface.",
    "Compute the mesh anew.",
    "Training goes on where it stopped.",
    "The network that training begins with.",
    "Runs are judged by their reward.",
    "A mistake of the plan is told in the outcome.",
    "Share of the frames that look at a lesion; shares of 0 to 1.",
    "A process of its own, beside what is there.",
)


@pytest.mark.parametrize("sentence", PLANTED)
def test_planted_sentences_are_unclear(sentence: str, tmp_path: Path) -> None:
    """As docstring, as documentation of a field, as message, and as heading."""
    program = f"""
    class Settings:
        '''{sentence}'''

        size: int = 1
        '''{sentence}'''

    def check(size):
        require(size > 0, "{sentence}")
        raise InputError(f"{sentence} Allowed: {{size}}.")
    """
    source, page = tmp_path / "file.py", tmp_path / "page.md"
    source.write_text(textwrap.dedent(program))
    page.write_text(f"# {sentence}\n\n```\n# {sentence}\n```\n")
    assert len(unclear_prose(source)) == 4
    assert len(questions(source)) == 2 * bool(OPENING.match(sentence))
    assert len(unclear_prose(page)) == 1


@pytest.mark.parametrize("sentence", (*PLANTED, "Whether all of it are numbers."))
def test_planted_comments_of_rust_are_unclear(sentence: str) -> None:
    """As documentation of a module, in several lines, and of a field; code comments may ask."""
    lines = sentence.replace(" ", "\n/// ")
    assert len(unclear_comments(f"//! {sentence}\n\n/// {lines}\nsize: u32, // {sentence}\n")) == 2
    assert len(unclear_comments(f"    /// {sentence}\n    size: u32,\n")) == 1
    assert not unclear_comments("// When the wall rests, nothing is to do.\n//// What is a rule?\n")
    assert unclear_comments("// Tries the step anew.\n") == ["Tries the step anew."]


@pytest.mark.parametrize(
    "sentence",
    (
        "Resume an interrupted recording.",
        "How to add a task",
        "fps is 0. Allowed: above 0.",
        "Fraction of the frames that show a lesion.",
    ),
)
def test_standard_sentences_are_clear(sentence: str) -> None:
    assert not unclear(sentence)
