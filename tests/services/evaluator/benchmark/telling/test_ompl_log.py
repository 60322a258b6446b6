"""The logs by OMPL's own grammar, and by OMPL's own reader, whose database Planner Arena opens."""

import re
import sqlite3
from dataclasses import dataclass

import pytest
from ompl import tools

from cspace.worlds.planar.planning.problems import Family
from services.evaluator.benchmark.runs.arms import pick, table
from services.evaluator.benchmark.summary.results import Results
from services.evaluator.benchmark.telling.ompl_log import PROGRESS, PROPERTIES, STATUS, ompl_log, planner_name

STAR, PLAIN = "RRT*, uniform, optimising", "RRT, uniform"
ARMS = pick(table([], 1.0), [PLAIN, STAR])


@pytest.fixture
def log(make_run, setting):
    star = {"arm": STAR, "group": "optimising", "planner": "RRTstar", "stop_at_first": False}
    costs = {
        "cost_s": (0.01, 0.02),
        "cost_iterations": (5, 9),
        "cost_edge_checks": (7, 30),
        "cost_length_rad": (4.5, 4.0),
    }
    runs = [
        make_run(),
        make_run(problem=1, solved=False, iterations=2000),
        make_run(**star, **costs),
        make_run(problem=1, solved=False, **star),
    ]
    results = Results.gather(runs, [Family.NARROW], ARMS, setting)
    return ompl_log(results.families[Family.NARROW], results, "2.0.1")


@dataclass
class Reader:
    """The grammar of OMPL's page on benchmarks, line by line."""

    lines: list[str]
    at: int = 0

    def line(self, pattern: str) -> re.Match:
        found = re.fullmatch(pattern, self.lines[self.at])
        assert found, f"line {self.at + 1}: {self.lines[self.at]!r} is no {pattern!r}"
        self.at += 1
        return found

    def block(self) -> None:
        self.line(r"<<<\|")
        while self.lines[self.at] != "|>>>":
            self.line(r".+")
        self.line(r"\|>>>")

    def header(self) -> int:
        self.line(r"\S+ version \S+")
        self.line(r"Experiment \S+")
        self.line(r"Running on \S+")
        self.line(r"Starting at .+")
        self.block()
        self.block()
        self.line(r"-?\d+ is the random seed")
        self.line(r"[\d.]+ seconds per run")
        self.line(r"[\d.]+ MB per run")
        self.line(r"\d+ runs per planner")
        self.line(r"[\d.]+ seconds spent to collect the data")
        for _ in range(int(self.line(r"(\d+) enum type")[1])):
            self.line(r"\w+(\|[^|]+)+")
        return int(self.line(r"(\d+) planners")[1])

    def planner(self) -> tuple[str, list[list[str]], list[list[list[str]]]]:
        name = self.line(r"(\S+)")[1]
        for _ in range(int(self.line(r"(\d+) common properties")[1])):
            self.line(r".+ = .*")
        kinds = "BOOLEAN|INTEGER|REAL|ENUM"
        columns = int(self.line(r"(\d+) properties for each run")[1])
        for _ in range(columns):
            self.line(rf".+ (?:{kinds})")
        number = r"(?:-?[\d.]+(?:e[-+]?\d+)?|inf|nan|)"
        count = int(self.line(r"(\d+) runs")[1])
        rows = [self.line(rf"(?:{number}; ){{{columns}}}")[0].split("; ")[:-1] for _ in range(count)]
        series: list[list[list[str]]] = []
        if self.lines[self.at] != ".":
            width = int(self.line(r"(\d+) progress properties for each run")[1])
            for _ in range(width):
                self.line(rf".+ (?:{kinds})")
            for _ in range(int(self.line(r"(\d+) runs")[1])):
                text = self.line(rf"(?:(?:{number},){{{width}}};)*")[0]
                series.append([step.split(",")[:-1] for step in text.split(";")[:-1]])
        self.line(r"\.")
        return name, rows, series


def test_a_log_follows_the_grammar_to_its_end(log):
    reader = Reader(log.splitlines())
    found = [reader.planner() for _ in range(reader.header())]
    assert reader.at == len(reader.lines)
    (plain, rows, nothing), (star, star_rows, series) = found
    assert (plain, star) == ("geometric_RRT_uniform", "geometric_RRTstar_uniform_optimising")
    names = [one.name for one in PROPERTIES]
    solved = dict(zip(names, rows[0], strict=True))
    assert (solved["time"], solved["solved"], solved["solution length"]) == ("0.003", "1", "4")
    assert STATUS[int(solved["status"])] == "Exact solution"
    failed = dict(zip(names, rows[1], strict=True))
    assert (failed["solved"], failed["solution length"], failed["iterations"]) == ("0", "", "2000")
    assert STATUS[int(failed["status"])] == "Timeout"
    assert nothing == []
    assert len(star_rows) == 2
    assert series == [[["0.01", "5", "7", "4.5"], ["0.02", "9", "30", "4"]], []]


def test_ompls_own_reader_makes_the_database_of_planner_arena(log, tmp_path, capsys):
    (tmp_path / "narrow.log").write_text(log)
    tools.readBenchmarkLog(str(tmp_path / "benchmark.db"), [str(tmp_path / "narrow.log")], moveitformat=False)
    connection = sqlite3.connect(tmp_path / "benchmark.db")
    try:
        (experiment,) = connection.execute("SELECT name, version, timelimit, runcount, seed FROM experiments")
        assert experiment == ("families_validation_narrow", "OMPL 2.0.1", 10.0, 2, "0")
        rows = connection.execute(
            "SELECT plannerConfigs.name, time, solved, solution_length, edge_checks FROM runs "
            "JOIN plannerConfigs ON plannerConfigs.id = runs.plannerid ORDER BY runs.id"
        ).fetchall()
        assert rows[0] == ("geometric_RRT_uniform", 0.003, 1, 4.0, 100)
        assert rows[1][2:4] == (0, None)
        progress = connection.execute("SELECT time, best_cost FROM progress ORDER BY time").fetchall()
        assert progress == [(0.01, 4.5), (0.02, 4.0)]
        enums = connection.execute("SELECT description FROM enums WHERE name = 'status' ORDER BY value")
        assert [row[0] for row in enums] == list(STATUS)
    finally:
        connection.close()
    assert "Processing" in capsys.readouterr().out


def test_names_of_planners_have_no_blanks_and_stay_apart():
    arms = table(["way", "flow"], 1.0)
    found = {planner_name(arm.name) for arm in arms}
    assert len(found) == len(arms)
    assert all(re.fullmatch(r"geometric_[A-Za-z0-9._-]+", name) for name in found)
    assert planner_name("RRT, uniform, range 0.5") == "geometric_RRT_uniform_range_0.5"


def test_progress_is_named_as_ompl_names_it():
    assert PROGRESS[0] == "time REAL"
    assert "best cost REAL" in PROGRESS
