"""Responses of participants: one CSV each in the study's folder, written after every trial, from a page or a terminal.

Every row names the study and repeats its trial, so that a row of another study or an edited one is noticed.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from ..errors import FileError, UsageError
from ..files import write_text
from .plan import Plan, Trial, order_trials

RESPONSES_NAME = "responses"
FIRST, SECOND = "first", "second"


@dataclass(frozen=True)
class Response:
    """One row of a participant's CSV.

    Attributes
    ----------
    study, participant : str
        Id of the study; the participant's name for it.
    trial, pair, repeat, reference, first, second
        The trial, see `Trial`.
    response : str
        "first" or "second".
    plays : int
        How often the stimuli of the trial were presented.
    seconds : float
        Time from the first presentation to the response [s].
    limited_samples, underruns : int
        Samples that the actuator's limiter changed, and times that the device ran out of them; 0 from a page.
    time_utc : str
        Time of the response.
    """

    study: str
    participant: str
    trial: int
    pair: str
    repeat: int
    reference: str
    first: str
    second: str
    response: str
    plays: int
    seconds: float
    limited_samples: int
    underruns: int
    time_utc: str

    @property
    def chosen(self) -> str:
        """The stimulus that was chosen."""
        return self.first if self.response == FIRST else self.second


COLUMNS = tuple(field.name for field in fields(Response))


def check_participant(name: str) -> str:
    """Return the name of a participant; raise UsageError if it would make no file name."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", name):
        raise UsageError(
            f"--participant {name[:60]!r}: a name has up to 40 letters, digits, - and _.", remedy="Give e.g. p01."
        )
    return name


def get_responses_path(folder: Path, participant: str) -> Path:
    """Return the path of a participant's CSV."""
    return folder / RESPONSES_NAME / f"{check_participant(participant)}.csv"


def read_responses(path: Path, plan: Plan) -> list[Response]:
    """Read a participant's CSV.

    Raises
    ------
    FileError
        If it is damaged, belongs to another study, or holds a trial that this participant does not have.
    """
    try:
        rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"), newline=""), strict=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Restore it from a copy.") from error
    responses, trials = [], {trial.number: trial for trial in order_trials(plan, path.stem)}
    for number, row in enumerate(rows, 2):
        where = f"{path}, line {number}"
        if tuple(row) != COLUMNS or None in row.values():
            raise FileError(
                "its columns are not those of a study.", where=where, remedy=f"They are {','.join(COLUMNS)}."
            )
        if row["study"] != plan.id:
            raise FileError(
                f"is a response to study {row['study'][:20]!r}, and this one is {plan.id}.",
                where=where,
                remedy="Move the file to the folder of its study.",
            )
        try:
            response = _parse_row(row)
        except ValueError as error:
            raise FileError(f"is damaged ({error}).", where=where, remedy="Restore it from a copy.") from error
        trial = trials.pop(response.trial, None)
        told = (response.trial, response.pair, response.repeat, response.reference, response.first, response.second)
        if response.participant != path.stem or trial is None or told != astuple(trial):
            raise FileError(
                f"trial {response.trial} is none of '{path.stem}', or is there twice.",
                where=where,
                remedy="Name the file after its participant, and leave its rows as they were written.",
            )
        responses.append(response)
    return responses


def read_all_responses(folder: Path, plan: Plan) -> dict[str, list[Response]]:
    """Read the responses of all participants of a study; raise FileError if there are none."""
    found = {path.stem: read_responses(path, plan) for path in sorted((folder / RESPONSES_NAME).glob("*.csv"))}
    responses = {participant: rows for participant, rows in found.items() if rows}
    if not responses:
        raise FileError(
            "there are no responses yet.",
            where=str(folder),
            remedy=f"Run it (hnf study run), or put the CSVs of its page into {folder / RESPONSES_NAME}.",
        )
    return responses


def append_response(path: Path, plan: Plan, response: Response) -> None:
    """Add a response to a participant's CSV; an earlier file is whole at every moment. Raises FileError."""
    earlier = read_responses(path, plan) if path.exists() else []
    if any(each.trial == response.trial for each in earlier):
        raise FileError(
            f"trial {response.trial} was answered meanwhile.",
            where=str(path),
            remedy="Run one session of a participant at a time.",
        )
    write_text(path, format_responses([*earlier, response]))


def format_responses(responses: list[Response]) -> str:
    """Format responses as CSV with a header."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(astuple(response) for response in responses)
    return out.getvalue()


def find_open_trials(plan: Plan, participant: str, responses: list[Response]) -> list[Trial]:
    """Return a participant's trials without a response, in their order."""
    done = {response.trial for response in responses}
    return [trial for trial in order_trials(plan, participant) if trial.number not in done]


def _parse_row(row: dict[str, str]) -> Response:
    kinds = {"int": int, "float": float, "str": str}
    response = Response(**{field.name: kinds[str(field.type)](row[field.name]) for field in fields(Response)})
    if response.response not in (FIRST, SECOND):
        raise ValueError(f"{response.response[:20]!r} is neither {FIRST} nor {SECOND}")
    if not (0.0 <= response.seconds < 1e9 and response.plays >= 0 and response.limited_samples >= 0):
        raise ValueError("a number is out of range")
    return response
