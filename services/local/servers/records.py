"""Records of started processes: one JSON file a service, written beside and renamed."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from cspace.errors import ServiceError
from cspace.files import write_json


@dataclass(frozen=True, slots=True)
class ProcessId:
    """A process for good: its id and when it came to be, as ids are used again."""

    pid: int
    create_time: float


@dataclass(frozen=True, slots=True)
class Record:
    """A process that was started here.

    Args:
        service: short name of the service.
        pid: its process id.
        create_time: when it came to be, Unix time in s; a process id alone may be somebody else's by now.
        argv: its command line.
        marker: a value in the environment of the process and all that it starts.
        root: the project that it was started from.
        address: where it listens.
        log: its log file.
        children: what it had started when it was ready. Programs that write a title of their own into their
            process wipe out the marker, and Ray's agents do.
    """

    service: str
    pid: int
    create_time: float
    argv: tuple[str, ...]
    marker: str
    root: str
    address: str
    log: str
    children: tuple[ProcessId, ...] = ()

    @property
    def process(self) -> ProcessId:
        """The process itself."""
        return ProcessId(self.pid, self.create_time)


def write_record(folder: Path, record: Record) -> None:
    """Keep a record; a reader sees the old one or the new one."""
    write_json(_path(folder, record.service), asdict(record), indent=1)


def read_record(folder: Path, service: str) -> Record | None:
    """The record of a service, None if it has none.

    Raises:
        ServiceError: the file is not a record.
    """
    path = _path(folder, service)
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        children = tuple(ProcessId(**child) for child in fields["children"])
        return Record(**{**fields, "argv": tuple(fields["argv"]), "children": children})
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, UnicodeDecodeError) as error:
        raise ServiceError(
            f"the record {path} is damaged",
            got=str(error),
            remedy="end the process that it was about, if there is one, and delete the file",
        ) from error


def drop_record(folder: Path, service: str) -> None:
    """Forget a service."""
    _path(folder, service).unlink(missing_ok=True)


def _path(folder: Path, service: str) -> Path:
    return folder / f"{service}.json"
