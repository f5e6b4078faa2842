"""Command line: one dataclass per verb, each in its own module."""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from importlib import import_module
from itertools import takewhile
from typing import Any, Protocol

from vrcaps._core import __version__
from vrcaps.cli.arguments import check_verb, option_error, require_file
from vrcaps.cli.console import EXIT_BROKEN_PIPE, configure_streams, discard_output, flush_output
from vrcaps.core.errors import MissingExtraError, VrcapsError, reason_of
from vrcaps.formats.format import FORMATS
from vrcaps.learn.registry import TASKS

EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130

_DESCRIPTION = """A virtual environment for capsule endoscopy: headless, exactly labeled, fast.

Start with `vrcaps demo`. Every verb shows examples with --help; `vrcaps --version` prints the
version."""


_VERBS = {
    "demo": ("vrcaps.cli.record", "Demo", "Record a labeled episode in a generated colon."),
    "record": ("vrcaps.cli.record", "Record", "Record an episode of an organ and a capsule."),
    "cockpit": (
        "vrcaps.cli.cockpit",
        "Cockpit",
        "Steer a capsule from a browser.",
    ),
    "bridge": (
        "vrcaps.cli.cockpit",
        "Bridge",
        "Publish sensors and accept commands over WebSocket.",
    ),
    "view": ("vrcaps.cli.episodes", "View", "View episodes in a browser."),
    "check": ("vrcaps.cli.episodes", "Check", "Verify an episode."),
    "scene": ("vrcaps.cli.episodes", "Scene", "Write the scene of an episode as MJCF or USD."),
    "coverage": ("vrcaps.cli.episodes", "Coverage", "Measure the coverage of the organ."),
    "reconstruct": ("vrcaps.cli.reconstruct", "Reconstruct", "Reconstruct the wall from images."),
    "compare-looks": (
        "vrcaps.cli.compare_looks",
        "CompareLooks",
        "Measure the distance of images to real ones.",
    ),
    "dataset make": ("vrcaps.cli.dataset", "Make", "Generate a data set from a plan."),
    "dataset check": ("vrcaps.cli.dataset", "Check", "Verify a data set."),
    "dataset composite": (
        "vrcaps.cli.dataset",
        "Composite",
        "Composite rendered lesions into real images.",
    ),
    "dataset card": ("vrcaps.cli.dataset", "Card", "Write the data card of a data set."),
    "dataset show": ("vrcaps.cli.dataset", "Show", "Show the contents of a data set."),
    "evaluate": ("vrcaps.cli.policy", "Evaluate", "Evaluate policies that steer the capsule."),
    "organ list": ("vrcaps.cli.organ", "List", "List organs, lesions, mucosae, capsules."),
    "organ inspect": ("vrcaps.cli.organ", "Inspect", "Measure and draw an organ."),
    "organ from-ct": ("vrcaps.cli.from_ct", "FromCt", "Create organs from a CT scan or labels."),
    "organ make": ("vrcaps.cli.organ", "Make", "Generate an organ and write it as GLB."),
    "organ texture": ("vrcaps.cli.texture", "Texture", "Create a mucosa from photographs."),
    "magnet list": ("vrcaps.cli.magnet", "List", "List magnets."),
    "magnet show": ("vrcaps.cli.magnet", "Show", "Show field, moment, mass and pull of a magnet."),
    "calibrate geometric": (
        "vrcaps.cli.calibrate",
        "CalibrateGeometric",
        "Fit a lens model to photographs of a chessboard.",
    ),
    "calibrate photometric": (
        "vrcaps.cli.calibrate",
        "CalibratePhotometric",
        "Estimate vignetting, color and noise of a camera from its frames.",
    ),
    "bench render": ("vrcaps.cli.bench", "Render", "Measure rendering."),
    "bench record": ("vrcaps.cli.bench", "Record", "Measure recording to disk."),
    "bench world": ("vrcaps.cli.bench", "World", "Measure the physics."),
    "train coverage": (
        "vrcaps.cli.policy",
        "Coverage",
        "Train a policy for coverage, by PPO.",
    ),
    "weights list": ("vrcaps.cli.weights", "List", "List published weights."),
    "weights pull": ("vrcaps.cli.weights", "Pull", "Fetch published weights by name."),
    "weights publish": ("vrcaps.cli.weights", "Publish", "Publish the best weights of a training."),
    "weights export": ("vrcaps.cli.weights", "Export", "Export trained weights as ONNX."),
    "doctor": ("vrcaps.cli.doctor", "Doctor", "Report the installation and missing extras."),
}
"""Module, dataclass and summary of each verb; those of families are added."""

_FAMILIES = {
    "export": (FORMATS, "vrcaps.cli.export"),
    "train": (TASKS, "vrcaps.cli.learn"),
    "evaluate": (TASKS, "vrcaps.cli.learn"),
    "predict": (TASKS, "vrcaps.cli.learn"),
}
"""Registry of the words after a verb, and the module of their commands."""

_GROUPS = {
    "train": "Train policies that steer a capsule, and networks on images.",
    "predict": "Predict from images with trained weights.",
    "weights": "List, fetch and publish trained weights; export them as ONNX.",
    "dataset": "Generate and verify data sets of many recordings, split by patient.",
    "export": "Export episodes and data sets to the layouts of other tools.",
    "evaluate": "Evaluate predictions from images by task, or policies.",
    "organ": "Generate organs, create them from CT, texture them from photographs, measure them.",
    "magnet": "List magnets and show the field and the pull of one.",
    "calibrate": "Calibrate the camera of a real capsule from photographs and frames.",
    "bench": "Measure speed on this machine.",
}

_EXTRAS = {"torch": "learn"}
"""Extra that installs a package which modules import at their top."""

_NOUNS = {"export": "format", "predict": "task", "evaluate": "task or policy"}
"""Terms for the word after the verb of a group, for messages."""


class _Command(Protocol):
    def run(self) -> None: ...


_SCENARIO_VERBS = ("record", "cockpit", "bridge")
"""Verbs whose argument is a scenario file."""


def main(args: Sequence[str] | None = None) -> None:
    """Run the command `vrcaps`.

    User errors end in one line on stderr and exit status 2, Ctrl-C in one line and status 130;
    neither prints a traceback.

    Args:
        args: Arguments after the program's name; None means those of the process.
    """
    configure_streams()
    args = sys.argv[1:] if args is None else args
    # NumPy is not imported yet. Its matrices are small here, and idle threads of BLAS keep
    # spinning, which takes time from the renderer.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        if list(args) == ["--version"]:
            sys.stdout.write(f"vrcaps {__version__}\n")
        else:
            _run(args)
    finally:
        flush_output()


def _run(args: Sequence[str]) -> None:
    """Run a command; errors become one line."""
    try:
        if (
            list(args[:1]) == ["train"]
            and " ".join(args[:2]) not in _VERBS
            and "--help" not in args
        ):
            import_module("vrcaps.cli.learn").check_paths(args)  # before PyTorch is loaded
        _parse(args).run()
    except VrcapsError as error:
        _stop(str(error), EXIT_BAD_INPUT)
    except ModuleNotFoundError as error:
        if error.name not in _EXTRAS:
            raise
        _stop(str(MissingExtraError(error.name, _EXTRAS[error.name])), EXIT_BAD_INPUT)
    except BrokenPipeError:
        discard_output()
        raise SystemExit(EXIT_BROKEN_PIPE) from None
    except OSError as error:
        reason = error.strerror or reason_of(error)
        _stop(f"{error.filename}: {reason}." if error.filename else f"{reason}.", EXIT_BAD_INPUT)
    except KeyboardInterrupt:
        _stop("Interrupted. Files written so far are complete.", EXIT_INTERRUPTED)


def _parse(args: Sequence[str]) -> _Command:
    """Parse a command line; only the module of its verb is imported.

    Without a verb, or with a group of verbs only, the help is printed.

    Raises:
        UnknownNameError: If there is no such verb.
        InputError: If an option is unknown or missing, or a value is invalid.
        SystemExit: If help was printed.
    """
    named = list(takewhile(lambda arg: not arg.startswith("-"), args))
    verbs = _all_verbs(named)
    check_verb(named, verbs, _NOUNS)
    if len(named) > 1 and named[0] in _SCENARIO_VERBS:  # before the scenario is imported
        require_file(named[1], "a scenario file (TOML, JSON) or the episode.json of an episode")
    if not args or (args == named and " ".join(named) in _GROUPS and named[0] not in verbs):
        sys.stderr.write(_help(named))
        raise SystemExit(EXIT_BAD_INPUT)
    message = io.StringIO()
    try:
        with redirect_stderr(message), warnings.catch_warnings():
            # A task of a plug-in need not state the type of its terms, which is not an option.
            warnings.filterwarnings("ignore", message="Could not resolve type parameter")
            return _app(args)
    except SystemExit as stop:
        # Without this, tyro draws a box around errors that a dataclass raises.
        error = stop.__context__
        while error is not None and not isinstance(error, VrcapsError):
            error = error.__context__
        verb = named[: 1 + (" ".join(named[:2]) in verbs)]
        error = error or option_error(message.getvalue(), lambda: _help(verb), " ".join(verb))
        if error is not None:
            raise error from None
        sys.stderr.write(message.getvalue())
        raise


def _app(args: Sequence[str]) -> Any:
    """Run the parser of all verbs."""
    from tyro.conf import DisallowNone, FlagCreatePairsOff
    from tyro.extras import SubcommandApp

    words = [arg for arg in args if not arg.startswith("-")]
    app, groups = SubcommandApp(), {}
    for path, (module, noun, summary) in _verbs(words).items():
        *group, verb = path.split()
        parent = app
        if group:
            parent = groups.setdefault(group[0], SubcommandApp())
            app.command(parent, name=group[0], help=_GROUPS[group[0]])
        if path.split() == words[: len(group) + 1]:
            parent.command(name=verb)(_command(module, path, noun))
        else:
            parent.command(name=verb, help=summary)(_not_chosen)
    markers = (DisallowNone, FlagCreatePairsOff)
    return app.cli(prog="vrcaps", description=_DESCRIPTION, args=args, config=markers)


def _command(module: str, path: str, noun: str) -> Any:
    """Dataclass of a verb; a module may create it from a registry."""
    commands = import_module(module)
    if hasattr(commands, "command"):
        return commands.command(*path.split())
    return getattr(commands, noun)


def _help(verb: Sequence[str]) -> str:
    """Help of a verb or a group of verbs; of the program without one."""
    text = io.StringIO()
    with redirect_stdout(text), suppress(SystemExit):
        _app([*verb, "--help"])
    return text.getvalue()


def _all_verbs(words: Sequence[str] = ()) -> dict[str, tuple[str, str, str]]:
    """All verbs; plug-ins, which may extend a family, are loaded only for a verb that has one."""
    verbs = dict(_VERBS)
    for verb, (registry, module) in _FAMILIES.items():
        kinds = registry if list(words[:1]) == [verb] else registry.built_in
        verbs |= {f"{verb} {kind}": (module, kind, registry.summary(kind)) for kind in kinds}
    return verbs


def _verbs(words: Sequence[str]) -> dict[str, tuple[str, str, str]]:
    """Verbs of a command line.

    `evaluate` is followed by the task of a network, or by policies.
    """
    verbs = _all_verbs(words)
    is_task = words[:1] == ["evaluate"] and " ".join(words[:2]) in verbs and len(words) > 1
    if is_task:
        del verbs["evaluate"]
        return verbs
    return {path: verb for path, verb in verbs.items() if not path.startswith("evaluate ")}


def _not_chosen() -> None:
    """Placeholder of the verbs that were not chosen."""


def _stop(message: str, status: int) -> None:
    sys.stderr.write(f"vrcaps: {message}\n")
    raise SystemExit(status)
