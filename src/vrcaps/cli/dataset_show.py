"""`vrcaps dataset card`, `vrcaps dataset show`: say what a data set holds."""

from __future__ import annotations

from dataclasses import dataclass

from tyro.conf import Positional

from vrcaps.cli.console import console


@dataclass(frozen=True)
class Card:
    """Write the data card of a data set anew: its README.md, as `dataset make` does at its end.

    The card says what the data set holds, how it was made, how to read it and what its limits are;
    its header is the one that the Hugging Face Hub reads. What is in the file before is replaced.
    License and description are those of the plan.

    For example:
      vrcaps dataset card runs/cohort
    """

    dataset: Positional[str]
    """Folder or URL of the data set."""

    def run(self) -> None:
        """Write and report.

        Raises:
            InputError: If there is no data set.
        """
        from vrcaps.data.card import CARD, write_card
        from vrcaps.data.store import open_store

        write_card(open_store(self.dataset))
        console.print(f"Wrote {self.dataset.rstrip('/')}/{CARD}.")
