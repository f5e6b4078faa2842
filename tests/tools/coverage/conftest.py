from small_episode import (
    base_scenario,
    device_file,
    mesh_file,
    organ,
    recorded,
    scenario,
)

__all__ = [
    "base_scenario",
    "device_file",
    "mesh_file",
    "organ",
    "recorded",
    "scenario",
]
