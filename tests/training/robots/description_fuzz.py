"""Descriptions of robots and their meshes, changed by chance: read rightly, or refused by typed errors.

``python -m tests.training.robots.description_fuzz KIND FIRST_SEED COUNT`` tries so many mutants of a kind of
:data:`MUTANTS` and prints what came of them. Each may take 2 s and 500 MB, xacro 6.5 s, and no file outside
its folder is opened or quoted. Where Pinocchio reads a description too, the arm's joints, limits and places
are the same.
"""

import os
import random
import re
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from lxml import etree

from cspace.errors import CspaceError
from tests.training.robots.test_arms_of_makers import placed
from training.robots import covering
from training.robots.importing import Imported, Request, import_robot

MOST_S, MOST_MB, TOLERANCE = 2.0, 500.0, 1e-6
# Processor time after which an expansion of xacro is ended, and a little more.
XACRO_S = 6.5
MARKER = "secret-7f3a"
LIMIT = 'effort="1" velocity="1"'
URDF = f"""<robot name="arm">
<link name="base"><collision><geometry><sphere radius="0.12"/></geometry></collision></link>
<link name="upper"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial></link><link name="lower"><visual><origin xyz="0 0 0.1" rpy="0 0.1 0"/><geometry>
<mesh filename="corner.obj" scale="1 1 1"/></geometry></visual></link>
<link name="hand"/><link name="finger"/><link name="other"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 0.2" rpy="0.1 0 1"/><axis xyz="0 1 0"/><limit lower="-2" upper="2.5" {LIMIT}/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0.1 0.3"/>
<axis xyz="2 0 1"/></joint>
<joint name="wrist" type="revolute"><parent link="lower"/><child link="hand"/>
<origin xyz="0.1 0 0.2" rpy="0 1.5 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" {LIMIT}/></joint>
<joint name="grip" type="prismatic"><parent link="hand"/><child link="finger"/>
<mimic joint="follow" multiplier="2"/><axis xyz="0 1 0"/><limit lower="0" upper="0.1" {LIMIT}/></joint>
<joint name="follow" type="prismatic"><parent link="base"/><child link="other"/><axis xyz="1 0 0"/>
<limit lower="0.01" upper="0.1" {LIMIT}/></joint></robot>"""
PAIR = '<disable_collisions link1="{}" link2="{}" reason="Never"/>'
PAIRS = "".join(PAIR.format(*one.split()) for one in ("base lower", "lower base", "hand base", "no base"))
SRDF = f'<robot name="arm"><group name="g"><chain base_link="base" tip_link="hand"/></group>{PAIRS}</robot>'
OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
CORNER = trimesh.load_mesh(trimesh.util.wrap_as_stream(OBJ), file_type="obj")
MESHES: dict[str, bytes] = {
    "obj": b"# a tip\no tip\nmtllib tip.mtl\nusemtl tip\n" + OBJ.encode(),
    "stl": CORNER.export(file_type="stl"),
    "ascii.stl": CORNER.export(file_type="stl_ascii").encode(),
    "ply": CORNER.export(file_type="ply"),
    "ascii.ply": CORNER.export(file_type="ply", encoding="ascii"),
    "dae": CORNER.export(file_type="dae"),
    "glb": CORNER.export(file_type="glb"),
}
PLAIN = "0 -0.0 -1 1 3.1 1e308 -1e308 1e-308 1e999 nan inf -inf x 0x10 1_0 1,5 1e3 1e-5 100 \u0663"
NUMBERS = (*PLAIN.split(), "", "1 2", "9" * 30, "4294967295", "-2147483649", "2000000000")
NAMES = (
    "base",
    "hand",
    "elbow",
    "fixed",
    "floating",
    "planar",
    "revolute",
    "é",
    "a b",
    "{x}",
    "%s",
    "\u202e",
)
OUTSIDE = """{out}/secret.{end} ../out/secret.{end} file://{out}/secret.{end} %2e%2e/out/secret.{end}
package://../out/secret.{end} package://arm/../out/secret.{end} package://out/secret.{end} linked/secret.{end}
link.{end} pipe.{end} *.{end} made.xacro package://arm/corner.{end} /dev/zero /etc/passwd ~/a.{end} . .."""
PATHS = (*OUTSIDE.split(), "", "x" * 5000, "http://127.0.0.1:9/secret.{end}")
LAUGHS = "".join(f'<!ENTITY x{n + 1} "{f"&x{n};" * 10}">' for n in range(9))
DOCTYPES = (
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file://{out}/secret.txt">]>',
    '<!DOCTYPE a SYSTEM "file://{out}/secret.txt">',
    '<!DOCTYPE a [<!ENTITY % p SYSTEM "{out}/secret.txt">%p;]>',
    f'<!DOCTYPE a [<!ENTITY x0 "aaaaaaaaaa">{LAUGHS}<!ENTITY x "&x9;">]>',
    '<!DOCTYPE a [<!ENTITY x "&x;">]>',
)
EXPRESSIONS = """9**9**9
'a' * 10**10
'x' * 10**8
[0] * 10**9
sum(range(10**10))
[i for i in range(10**8)]
max(list(range(10**8)))
'%0999999999d' % 1
str(10**10**6)
1/0
lambda: 0
open('{out}/secret.txt').read()
__import__('os').listdir('/')
().__class__.__base__.__subclasses__()
xacro.load_yaml('{out}/secret.txt')
xacro.load_yaml('link.txt')
xacro.load_yaml('pipe.txt')
[[b for b in range(9**6)] for a in range(9**6)]
xacro.error('a')""".splitlines()
SUBSTITUTIONS = """env HOME
optenv HOME a
find out
find ..
find {out}
find /
arg no
dirname
eval 9**9**9
eval open('{out}/secret.txt').read()""".splitlines()
MACROS = "".join(f'<xacro:macro name="m{n}">{f"<xacro:m{n + 1}/>" * 10}</xacro:macro>' for n in range(9))
TENS = "".join(f'<xacro:property name="p{n + 1}" value="{f"${{p{n}}}" * 10}"/>' for n in range(8))
SNIPPETS = (
    *(f'<a b="${{{words}}}"/>' for words in EXPRESSIONS),
    *(f'<a b="$({words})"/>' for words in SUBSTITUTIONS),
    *(f'<xacro:include filename="{path}"/>' for path in PATHS),
    f'{MACROS}<xacro:macro name="m9"><link name="x"/></xacro:macro><xacro:m0/>',
    f'<xacro:property name="p0" value="aaaaaaaaaa"/>{TENS}<a b="${{p8}}"/>',
    *"""<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>
<xacro:property name="p" value="${p}"/><a b="${p}"/>
<xacro:macro name="q" params="a:=1 *b **c d:=^|2"><xacro:insert_block name="b"/></xacro:macro><xacro:q/>
<xacro:if value="${x}"><a/></xacro:if>
<xacro:unless value="nan"><a/></xacro:unless>
<xacro:call macro="${m}"/>
<xacro:element xacro:name="${1}"/>
<xacro:no/>""".splitlines(),
)
Rng = random.Random


@dataclass(slots=True)
class Found:
    """What came of mutants: how many of each outcome, what is wrong, and which took the most s and MB."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    slowest: tuple[float, int] = (0.0, -1)
    largest: tuple[float, int] = (0.0, -1)
    most_s: float = MOST_S

    def judge(self, number: int, tried: Callable[[], str], place: "Place") -> None:
        """Take in what comes of one mutant."""
        wrong = ""
        place.opened.clear()
        before_s, before_mb = sum(os.times()[:4]), _memory_mb("VmRSS")
        # The peak is from now on.
        Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")
        try:
            outcome = tried()
        except CspaceError as error:
            outcome = "refused"
            wrong = f"tells {error}" if MARKER in str(error) or "Traceback" in str(error) else ""
        except Exception as error:  # noqa: BLE001 # whatever comes is what is looked for
            outcome, wrong = "fault", f"{type(error).__name__}: {error}"
        took_s = sum(os.times()[:4]) - before_s
        # Not that of children: until one runs a program, its parent's counts. The kernel bounds xacro's.
        grew_mb = _memory_mb("VmHWM") - before_mb
        self.counts[outcome] += 1
        self.slowest = max(self.slowest, (round(took_s, 2), number))
        self.largest = max(self.largest, (round(grew_mb), number))
        wrong = wrong or (f"opened {place.opened}" if place.opened else "")
        wrong = wrong or (f"took {took_s:.1f} s" if took_s > self.most_s else "")
        if wrong := wrong or (f"grew {grew_mb:.0f} MB" if grew_mb > MOST_MB else ""):
            self.faults.append(f"{number}: {wrong[:300]}")
            print(self.faults[-1], file=sys.stderr, flush=True)  # noqa: T201 # for long runs

    def __str__(self) -> str:
        most = "slowest {} s ({}), largest {} MB ({})".format(*self.slowest, *self.largest)
        return "\n".join([f"{dict(sorted(self.counts.items()))}; {most}", *self.faults])


def alone(run: Callable[..., Found], *arguments: object) -> Found:
    """What a run finds in a process of its own: a child's memory counts that of the process it came from."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(run, *arguments).result()


def _memory_mb(name: str) -> float:
    rows = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(row.split()[1]) for row in rows if row.startswith(name)) / 1024


class Place:
    """A folder for mutants, and one outside, of which nothing may be read."""

    def __init__(self, top: Path) -> None:
        self.folder, self.out = top / "arm", top / "out"
        self.out.mkdir()
        for end in ("xacro", "urdf", "srdf", *MESHES):
            data = MESHES.get(end, f'<robot name="{MARKER}"><link name="{MARKER}"/></robot>'.encode())
            (self.out / f"secret.{end}").write_bytes(data)
        (self.out / "secret.txt").write_text(f"a: {MARKER}\n", encoding="utf-8")
        self.opened: list[str] = []
        sys.addaudithook(self._audit)

    def _audit(self, event: str, details: tuple[object, ...]) -> None:
        outside = event == "open" and os.path.realpath(str(details[0])).startswith(f"{self.out}/")
        if outside or event == "socket.connect":
            self.opened.append(f"{event} {details[0]}")

    def fresh(self) -> Path:
        """The folder, empty but for a mesh, links to outside, and pipes into which nobody writes."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        (self.folder / "linked").symlink_to(self.out)
        for end in ("obj", "xacro", "txt"):
            (self.folder / f"link.{end}").symlink_to(self.out / f"secret.{end}")
            os.mkfifo(self.folder / f"pipe.{end}")
        (self.folder / "corner.obj").write_text(OBJ, encoding="utf-8")
        return self.folder

    def value(self, rng: Rng, before: str) -> str:
        """Another value of an attribute."""
        words = before.split()
        if words and re.fullmatch(r"[-+.\de]+", words[0]) and rng.random() < 0.8:
            words[rng.randrange(len(words))] = rng.choice(NUMBERS)
            return " ".join(words)
        return self.filled(rng.choice((*PATHS, *NAMES, *NUMBERS)), "obj")

    def filled(self, text: str, end: str) -> str:
        """A text with the paths of secrets that end so."""
        return text.replace("{out}", str(self.out)).replace("{end}", end)


def changed_tree(rng: Rng, place: Place, root: Any) -> None:
    """Change an attribute or an element somewhere below a root."""
    everything = list(root.iter(etree.Element))
    element = rng.choice(everything)
    key, parent, kind = rng.choice([*element.keys(), None]), element.getparent(), rng.randrange(8)
    if kind < 3 and key is not None:
        element.set(key, place.value(rng, element.get(key)))
    elif kind == 3 and key is not None:
        del element.attrib[key]
    elif parent is None:
        element.tag = rng.choice(("robot", "sdf", "{a}robot"))
    elif kind == 4:
        parent.remove(element)
    elif kind == 5:
        for number in range(rng.choice((1, 1, 2, 20))):
            copy = deepcopy(element)
            if element.get("name") and rng.random() < 0.5:
                copy.set("name", f"{element.get('name')}{number}")
            parent.insert(parent.index(element), copy)
    elif kind == 6:
        rng.choice([one for one in everything if element not in (one, *one.iterancestors())]).append(element)
    else:
        include = "{http://www.w3.org/2001/XInclude}include"
        element.tag = rng.choice((include, *(one.tag for one in everything)))
        for _ in range(rng.choice((0, 0, 2, 300))):
            around = etree.Element(element.tag)
            parent.replace(element, around)
            around.append(element)
            parent = around


def changed_xml(rng: Rng, place: Place, text: bytes) -> bytes:
    """XML with elements, attributes, entities or bytes changed."""
    root = etree.fromstring(text)
    for _ in range(rng.choice((0, 1, 1, 1, 2, 4))):
        changed_tree(rng, place, root)
    data: bytes = etree.tostring(root)
    if rng.random() < 0.1:
        head = place.filled(rng.choice(DOCTYPES), "txt").encode()
        data = head + re.sub(rb'"(\d|base|arm)', rb'"&x;\1', data, count=rng.choice((1, 1, 0)))
    if rng.random() < 0.05:
        code = rng.choice(("utf-16", "utf-32", "latin-1", "utf-7"))
        data = f'<?xml version="1.0" encoding="{code}"?>{data.decode()}'.encode(code, errors="replace")
    return damaged(rng, data) if rng.random() < 0.1 else data


def damaged(rng: Rng, data: bytes) -> bytes:
    """Bytes changed, dropped, put in, doubled, or cut off."""
    found = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8))):
        at, size, kind = rng.randrange(len(found) or 1), rng.choice((1, 1, 2, 4, 64)), rng.randrange(6)
        if kind < 2:
            found[at : at + size] = (
                rng.randbytes(size) if kind else rng.choice((b"\0", b"\xff", b"\x7f")) * size
            )
        elif kind == 2:
            del found[at : at + size]
        elif kind == 3:
            found[at:at] = rng.randbytes(size)
        elif kind == 4:
            found[at:at] = found[at : at + rng.choice((4, 64, 4096))] * rng.choice((1, 3))
        else:
            del found[rng.choice((at, max(len(found) - size, 0))) :]
    return bytes(found)


def changed_words(rng: Rng, place: Place, data: bytes) -> bytes:
    """A text whose words and lines are changed."""
    lines = data.decode(errors="replace").splitlines()
    for _ in range(rng.choice((1, 1, 2, 4))):
        at, kind = rng.randrange(len(lines)), rng.randrange(5)
        words = lines[at].split() or [""]
        words[rng.randrange(len(words))] = place.value(rng, rng.choice(words))
        more = [lines[at]] * rng.choice((2, 99))
        lines[at : at + 1] = [" ".join(words)] if kind < 3 else more if kind == 3 or len(lines) == 1 else []
    return "\n".join(lines).encode(errors="replace")


def nested_nodes(rng: Rng, data: bytes) -> bytes:
    """A COLLADA file whose nodes hold others many times, or themselves."""
    depth, times, last = rng.choice((2, 9)), rng.choice((1, 8)), rng.choice(("n0", "tip", "no"))
    targets = [*(f"n{at}" for at in range(1, depth)), last]
    nodes = [
        f'<node id="n{at}">{f"""<instance_node url="#{target}"/>""" * times}</node>'
        for at, target in enumerate(targets)
    ]
    text = data.decode().replace('id="node0"', 'id="tip"')
    return text.replace("</visual_scene>", f"{''.join(reversed(nodes))}</visual_scene>").encode()


def urdf(rng: Rng, place: Place) -> Request:
    """A changed URDF file."""
    path = place.folder / "arm.urdf"
    path.write_bytes(changed_xml(rng, place, URDF.encode()))
    return Request(path, tip="hand")


def xacro(rng: Rng, place: Place) -> Request:
    """A changed xacro file."""
    path = place.folder / "made.xacro"
    text = URDF.replace(">", ' xmlns:xacro="http://www.ros.org/wiki/xacro">', 1)
    text = text.replace("0.12", "${0.24 / 2}")
    for _ in range(rng.choice((0, 1, 1, 2))):
        more = place.filled(rng.choice(SNIPPETS), rng.choice(("xacro", "txt")))
        where = rng.choice(("<link", "<joint", "</robot>"))
        text = text.replace(where, more + where, 1)
    path.write_bytes(changed_xml(rng, place, text.encode()))
    return Request(path, tip="hand")


def srdf(rng: Rng, place: Place) -> Request:
    """A whole URDF file with a changed SRDF file."""
    (place.folder / "arm.urdf").write_text(URDF, encoding="utf-8")
    path, data = place.folder / "arm.srdf", changed_xml(rng, place, SRDF.encode())
    if rng.random() < 0.05:
        data = data.replace(b"</robot>", PAIR.format("a", "b").encode() * 100_000 + b"</robot>")
    if rng.random() < 0.05:
        path.symlink_to(place.out / "secret.srdf")
    else:
        path.write_bytes(data)
    return Request(place.folder / "arm.urdf", tip="hand")


def mesh(rng: Rng, place: Place) -> Request:
    """A whole URDF file with a changed mesh."""
    end = rng.choice(list(MESHES))
    data = nested_nodes(rng, MESHES[end]) if end == "dae" and rng.random() < 0.2 else MESHES[end]
    if end == "dae" and rng.random() < 0.5:
        data = changed_xml(rng, place, data)
    elif end in {"obj", "ascii.stl", "ascii.ply", "dae"} and rng.random() < 0.7:
        data = changed_words(rng, place, data)
    else:
        data = damaged(rng, data)
    if rng.random() < 0.05:
        end = rng.choice(("obj", "stl", "ply", "dae", "off", "xyz", "zip", "3mf", "gltf", "svg"))
    path = place.folder / f"tip.{end}"
    if rng.random() < 0.02:
        path.symlink_to(place.out / f"secret.{end}")
    else:
        path.write_bytes(data)
    scale = " ".join(rng.choice(NUMBERS) for _ in "xyz") if rng.random() < 0.1 else "1 1 1"
    text = URDF.replace("corner.obj", path.name).replace('scale="1 1 1"', f'scale="{scale}"')
    (place.folder / "arm.urdf").write_text(text, encoding="utf-8")
    return Request(place.folder / "arm.urdf", tip="hand")


def outcome(request: Request) -> str:
    """Import a robot, and hold it against Pinocchio where that reads the file too."""
    found = import_robot(request)
    assert MARKER not in repr(found), "the secret is in the arm"
    assert max(fit.missed_m for fit in found.fits.values()) < 0.003, "a part is not covered"
    if request.urdf.suffix != ".xacro" and as_pinocchio(request.urdf, found):
        return "an arm as Pinocchio's"
    return "an arm"


def as_pinocchio(path: Path, found: Imported) -> bool:
    """Whether Pinocchio reads a description too; then it has the same joints, limits and places."""
    # Of the extra `spatial`.
    import pinocchio as pin

    try:
        model = pin.buildModelFromUrdf(str(path))
    except (ValueError, RuntimeError, IndexError):
        return False
    data, arm, tip = model.createData(), found.arm, model.getFrameId("hand", pin.FrameType.BODY)
    ids = [model.getJointId(joint.name) for joint in arm.joints]
    for joint, number in zip(arm.joints, ids, strict=True):
        at = model.joints[number].idx_q
        limits = (model.lowerPositionLimit[at], model.upperPositionLimit[at])
        assert joint.limits_rad in {None, limits}, f"limits of {joint.name}: {joint.limits_rad} and {limits}"
    drawn = np.random.default_rng(0).uniform(arm.space.lower, arm.space.upper, (3, arm.dim))
    for row, mine, tool in zip(drawn, arm.link_frames(drawn)[:, 1:], arm.tool_frames(drawn), strict=True):
        values = {one.name: one.value for one in found.held}
        values |= {joint.name: value for joint, value in zip(arm.joints, row, strict=True)}
        pin.framesForwardKinematics(model, data, placed(pin, model, values))
        theirs = [*(data.oMi[number].homogeneous for number in ids), data.oMf[tip].homogeneous]
        assert np.abs(theirs - np.stack([*mine, tool])).max() < TOLERANCE, "a joint or the tip is elsewhere"
    return True


MUTANTS: dict[str, Callable[[Rng, Place], Request]] = {
    "urdf": urdf,
    "xacro": xacro,
    "srdf": srdf,
    "mesh": mesh,
}


def run(kind: str, seed: int, count: int) -> Found:
    """Try so many mutants of a kind."""
    covering._GRID_POINTS = 4000
    found = Found(most_s=XACRO_S if kind == "xacro" else MOST_S)
    with tempfile.TemporaryDirectory() as top:
        place = Place(Path(top).resolve())
        (place.fresh() / "arm.urdf").write_text(URDF, encoding="utf-8")
        # Compiles what has to be.
        assert outcome(Request(place.folder / "arm.urdf", tip="hand")) == "an arm as Pinocchio's"
        for number in range(seed, seed + count):
            place.fresh()
            found.judge(number, partial(outcome, MUTANTS[kind](Rng(number), place)), place)
    return found


if __name__ == "__main__":
    print(run(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])))  # noqa: T201
