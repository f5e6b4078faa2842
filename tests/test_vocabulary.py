"""Public names, keys, columns and flags use the field's terms (docs/reference/glossary.md)."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
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


OPENING = re.compile(r"(What|How|Where|Which|Who|Whose|Why|When)\b")
"""First words of a docstring that hide its subject."""
IDIOMS = re.compile(
    r"\banew\b|\bgo(es)? on\b|\bbeg[ia]ns? with\b|\b(told|tells?) apart\b|\bis told\b"
    r"|\bjudg(e|es|ed|ing)\b|\bshares? of\b"
)
"""Idioms with a term in the glossary: again, resume, initialize, distinguish, report, evaluate,
fraction."""


def unclear(text: str) -> bool:
    """Whether a docstring opens with a question word or contains an idiom; commands are ignored."""
    prose = [line for line in text.splitlines() if "runs/" not in line]
    return bool(OPENING.match(text) or IDIOMS.search("\n".join(prose)))


def docstrings(path: Path) -> Iterator[tuple[str, str]]:
    """Names and docstrings of a file."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, kinds) and (text := ast.get_docstring(node)):
            yield getattr(node, "name", path.name), text


def test_docstrings_state_their_subject_first() -> None:
    found = [
        f"{path.relative_to(PACKAGE)}: {name}"
        for path in FILES
        for name, text in docstrings(path)
        if unclear(text)
    ]
    assert not found


@pytest.mark.parametrize(
    "sentence",
    [
        "What one capsule is about.",
        "How near an image is to its original.",
        "Where points lie best on a surface.",
        "Which images have shadows.",
        "Compute the mesh anew.",
        "Training goes on where it stopped.",
        "The network that training begins with.",
        "Runs are judged by their reward.",
        "A mistake of the plan is told in the outcome.",
        "Share of the frames that look at a lesion; shares of 0 to 1.",
    ],
)
def test_planted_sentences_are_unclear(sentence: str) -> None:
    assert unclear(sentence)
    assert not unclear("Resume an interrupted recording.")
