"""Arms by name, one TOML file each in `arms/`, and a user's own files."""

from __future__ import annotations

from pathlib import Path

from vrcaps.actuation.arm.arm import Arm, Joint, Link
from vrcaps.catalog_folder import CatalogFolder
from vrcaps.toml_table import DEGREE, MILLI, TomlTable

_ARMS = CatalogFolder(Path(__file__).parent / "arms", "arm")


def arm_names() -> tuple[str, ...]:
    """Names of the catalog's arms, sorted."""
    return _ARMS.names()


def read_arm(name_or_path: str | Path) -> Arm:
    """An arm of the catalog by its name, or a user's own by the path of its TOML file.

    Raises:
        UnknownNameError: If the catalog has no arm of that name.
        InputError: If there is no such file, or it describes no possible arm.
    """
    return _parse_arm(_ARMS.find(name_or_path))


def _parse_arm(path: Path) -> Arm:
    """Read an arm from its TOML file (see `arms/panda.toml`); its name is the file's name.

    Raises:
        InputError: If the file cannot be read, is no TOML, lacks a key, has a key too many or of
            the wrong type, or describes no possible arm.
    """
    table = TomlTable.read(path, "arm")
    title = table.text("title")
    source = table.text("source") if table.has("source") else ""
    offset = _place(table, "flange_offset_mm")
    home = table.numbers("home_deg", None, DEGREE)
    payload = table.number("payload_kg", above=0)
    joints = tuple(_read_joint(joint) for joint in table.tables("joints"))
    links = tuple(map(_read_link, table.tables("links"))) if table.has("links") else ()
    collision_pairs = _read_pairs(table) if table.has("collision_pairs") else ()
    table.finish()
    return Arm(path.stem, title, joints, offset, home, payload, links, collision_pairs, source)


def _read_joint(table: TomlTable) -> Joint:
    joint = Joint(
        a=table.number("a_mm", MILLI),
        d=table.number("d_mm", MILLI),
        alpha=table.number("alpha_deg", DEGREE),
        theta=table.number("theta_deg", DEGREE),
        lower=table.number("lower_rad"),
        upper=table.number("upper_rad"),
        velocity=table.number("velocity_rad_per_s"),
        acceleration=table.number("acceleration_rad_per_s2"),
        jerk=table.number("jerk_rad_per_s3"),
        torque=table.number("torque_nm"),
    )
    table.finish()
    return joint


def _read_link(table: TomlTable) -> Link:
    link = Link(
        frame=int(table.number("frame")),
        start=_place(table, "start_mm"),
        end=_place(table, "end_mm"),
        radius=table.number("radius_mm", MILLI, above=0),
    )
    table.finish()
    return link


def _place(table: TomlTable, key: str) -> tuple[float, float, float]:
    x, y, z = table.numbers(key, 3, MILLI)
    return x, y, z


def _read_pairs(table: TomlTable) -> tuple[tuple[int, int], ...]:
    allowed = "a list of pairs of frame numbers"
    pairs = table.take("collision_pairs", allowed)
    are_pairs = isinstance(pairs, list) and all(
        isinstance(p, list) and len(p) == 2 and all(isinstance(f, int) for f in p) for p in pairs
    )
    return (
        tuple((i, j) for i, j in pairs)
        if are_pairs
        else table.fail("collision_pairs", pairs, allowed)
    )
