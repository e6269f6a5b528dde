"""Robot descriptions: kinematics against theory and a peer, and every kind of broken file."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.glb import to_glb
from scene.mesh import box_mesh
from scene.robot import Robot, load_robot
from spatial.errors import FileInputError, InputError

SAM = Path(__file__).parents[2] / "assets" / "robots" / "sam" / "robot.urdf"
ARM = ("A1", "A2", "E1", "A3", "A4", "A5", "A6")
LINKS = '<link name="a"/><link name="b"/>'
JOINT = '<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{more}</joint>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


@pytest.fixture(scope="module")
def sam() -> Robot:
    return load_robot(SAM)


def robot(folder: Path, inside: str, *, head: str = "") -> Robot:
    path = folder / "robot.urdf"
    path.write_text(f'{head}<robot name="r">\n{inside}\n</robot>', encoding="utf-8")
    return load_robot(path)


def dh(theta: float, d: float, alpha: float) -> np.ndarray:
    """Return the transform of one row of Denavit-Hartenberg parameters, a = 0."""
    ct, st_, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    return np.array(
        [
            (ct, -st_ * ca, st_ * sa, 0),
            (st_, ct * ca, -ct * sa, 0),
            (0, sa, ca, d),
            (0, 0, 0, 1),
        ]
    )


def published_flange(q: np.ndarray) -> np.ndarray:
    """Return the pose of the LWR's flange in its base from its published parameters."""
    lengths = (0.3105, 0.0, 0.4, 0.0, 0.39, 0.0, 0.078)
    twists = np.array((1, -1, -1, 1, 1, -1, 0)) * (math.pi / 2)
    pose = np.eye(4)
    for theta, d, alpha in zip(q, lengths, twists, strict=True):
        pose = pose @ dh(theta, d, alpha)
    return pose


def test_the_arm_is_the_published_lwr(sam: Robot) -> None:
    rng = np.random.default_rng(1)
    for q in (np.zeros(7), *rng.uniform(-2.0, 2.0, (20, 7))):
        poses = sam.fk(dict(zip(ARM, q.tolist(), strict=True)))
        T_base_flange = poses["base"].inverse() @ poses["link_7"]
        np.testing.assert_allclose(T_base_flange.matrix, published_flange(q), atol=1e-9)


def test_the_flange_is_1178_mm_above_the_base_at_zero(sam: Robot) -> None:
    poses = sam.fk({})
    flange = (poses["base"].inverse() @ poses["link_7"]).translation
    np.testing.assert_allclose(flange, (0, 0, 1.1785), atol=1e-12)


def test_limits_are_those_of_the_data_sheet(sam: Robot) -> None:
    joints = [joint for joint in sam.joints if joint.name in ARM]
    assert [round(math.degrees(joint.upper or 0)) for joint in joints] == [
        170, 120, 170, 120, 170, 120, 170,
    ]  # fmt: skip
    assert [joint.effort for joint in joints] == [176, 176, 100, 100, 100, 38, 38]
    speeds = [round(math.degrees(joint.velocity or 0)) for joint in joints]
    assert speeds == [110, 110, 128, 128, 204, 184, 184]


def test_the_frames_others_rely_on(sam: Robot) -> None:
    poses = sam.fk({})
    assert sam.root == "platform"
    assert not sam.warnings
    np.testing.assert_allclose(poses["base"].rotation, np.diag((1.0, -1.0, -1.0)), atol=1e-9)
    T_flange_tcp = poses["link_7"].inverse() @ poses["tcp"]
    np.testing.assert_allclose(T_flange_tcp.rotation, np.eye(3), atol=1e-9)
    assert T_flange_tcp.translation[2] > 0.2
    T_tcp_hc = poses["tcp"].inverse() @ poses["hc"]
    np.testing.assert_allclose(T_tcp_hc.rotation[:, 2], (0, 0, 1), atol=1e-9)
    forward_down = poses["mako"].rotation[:, 2]
    assert forward_down[0] > 0.1
    assert forward_down[2] < -0.8


def test_the_hand_eye_camera_sees_the_hook_at_its_rim_and_the_rest_free(sam: Robot) -> None:
    poses = sam.fk({})
    T_hc_tool = poses["hc"].inverse() @ poses["tool"]
    tool = next(visual for visual in sam.visuals if visual.link == "tool")
    points = T_hc_tool.apply(tool.mesh.vertices)
    points = points[points[:, 2] > 0.06]
    u = 640 + 1078 * points[:, 0] / points[:, 2]
    v = 480 + 1078 * points[:, 1] / points[:, 2]
    seen = (abs(u - 640) < 640) & (abs(v - 480) < 480)
    assert seen.any(), "the tip of the hook is in the picture"
    assert v[seen].min() > 0.6 * 960, "and only in its lower part"


def test_kinematics_agree_with_a_peer(tmp_path: Path) -> None:
    inside = """
    <link name="a"/><link name="b"/><link name="c"/><link name="d"/>
    <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/>
      <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/><axis xyz="0 0.6 0.8"/>
      <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
    <joint name="turn" type="continuous"><parent link="b"/><child link="c"/>
      <origin xyz="0 0 0.2" rpy="1 0 0"/><axis xyz="1 0 0"/></joint>
    <joint name="hold" type="fixed"><parent link="c"/><child link="d"/>
      <origin xyz="0.3 0 0"/></joint>"""
    ours = robot(tmp_path, inside)
    peer = yourdfpy.URDF.load(str(tmp_path / "robot.urdf"), load_meshes=False)
    rng = np.random.default_rng(2)
    for slide, turn in rng.uniform(-1, 1, (20, 2)):
        values = {"slide": float(slide), "turn": float(turn)}
        peer.update_cfg(values)
        poses = ours.fk(values)
        for link in ours.links:
            np.testing.assert_allclose(poses[link].matrix, peer.get_transform(link), atol=1e-12)


def test_our_robot_agrees_with_a_peer(sam: Robot) -> None:
    peer = yourdfpy.URDF.load(str(SAM), load_meshes=False, build_scene_graph=True)
    values = dict(zip(ARM, (0.3, -0.5, 0.7, 1.1, -0.9, 0.6, 2.0), strict=True))
    peer.update_cfg(values)
    poses = sam.fk(values)
    for link in sam.links:
        np.testing.assert_allclose(poses[link].matrix, peer.get_transform(link), atol=1e-12)


def test_kinematics_are_fast(sam: Robot) -> None:
    values = dict.fromkeys(ARM, 0.1)
    rounds = []
    for _ in range(5):
        start = time.process_time()
        for _ in range(100):
            sam.fk(values)
        rounds.append((time.process_time() - start) / 100)
    assert min(rounds) < 150e-6


def test_masses_suit_a_simulation(sam: Robot) -> None:
    arm = [sam.inertials[f"link_{i}"] for i in range(1, 8)] + [sam.inertials["base"]]
    assert math.isclose(sum(inertial.mass_kg for inertial in arm), 16.0)
    for inertial in sam.inertials.values():
        a, b, c = sorted(np.linalg.eigvalsh(inertial.inertia))
        assert a > 0
        assert a + b >= c, "moments of a real body obey the triangle inequality"


def test_a_mimic_follows_and_an_explicit_value_wins(tmp_path: Path) -> None:
    inside = f"""{LINKS}<link name="c"/>
    {JOINT.format(kind="continuous", more="")}
    <joint name="k" type="continuous"><parent link="b"/><child link="c"/>
      <mimic joint="j" multiplier="-2" offset="0.1"/></joint>"""
    made = robot(tmp_path, inside)
    follow = (made.fk({"j": 0.3})["b"].inverse() @ made.fk({"j": 0.3})["c"]).log()[3]
    assert math.isclose(follow, -0.5)
    poses = made.fk({"j": 0.3, "k": 1.0})
    assert math.isclose((poses["b"].inverse() @ poses["c"]).log()[3], 1.0)


def test_positions_are_checked(sam: Robot) -> None:
    with pytest.raises(InputError, match="unknown joint 'A9'; available: A1, A2"):
        sam.fk({"A9": 0.0})
    with pytest.raises(InputError, match="not finite"):
        sam.fk({"A1": math.nan})


BROKEN = [
    ("<link name='a'>", "not XML", 3),
    ("", "no <link>", 1),
    ("<link/>", "no 'name'", 2),
    (LINKS, "one root link; found a, b", 1),
    ('<link name="a"/><link name="a"/>', "2 links are named 'a'", 2),
    (LINKS + JOINT.format(kind="hinge", more=""), "unknown type 'hinge'; available: continuous", 2),
    (LINKS + JOINT.format(kind="fixed", more="") * 2, "2 joints are named 'j'", 2),
    ('<link name="a"/>' + JOINT.format(kind="fixed", more=""), "unknown link 'b'", 2),
    (LINKS + JOINT.format(kind="continuous", more='<axis xyz="0 0 0"/>'), "axis of length 0", 2),
    (LINKS + JOINT.format(kind="continuous", more='<axis xyz="0 nan 0"/>'), "3 finite", 2),
    (LINKS + JOINT.format(kind="fixed", more='<origin xyz="0 0"/>'), "3 finite", 2),
    (
        LINKS
        + JOINT.format(
            kind="revolute", more='<limit lower="1" upper="-1" effort="1" velocity="1"/>'
        ),
        "lower limit 1 above upper limit -1",
        2,
    ),
    (LINKS + JOINT.format(kind="fixed", more='<mimic joint="x"/>'), "unknown joint 'x'", 2),
    (LINKS + JOINT.format(kind="fixed", more='<mimic joint="j"/>'), "loop", 2),
    ('<link name="a"><visual/></link>', "no <geometry>", 2),
    ('<link name="a"><visual><geometry><cone/></geometry></visual></link>', "holds 0 of box", 2),
    (
        '<link name="a"/><link name="b"/><link name="c"/>'
        + JOINT.format(kind="fixed", more="")
        + '<joint name="k" type="fixed"><parent link="c"/><child link="b"/></joint>',
        "child of joint 'k' and of another",
        2,
    ),
    (
        '<link name="r"/>'
        + LINKS
        + JOINT.format(kind="fixed", more="")
        + '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>',
        "loop",
        2,
    ),
]


@pytest.mark.parametrize(("inside", "said", "line"), BROKEN)
def test_broken_descriptions_name_line_and_reason(
    tmp_path: Path, inside: str, said: str, line: int
) -> None:
    with pytest.raises(FileInputError) as caught:
        robot(tmp_path, inside)
    assert said in str(caught.value)
    assert caught.value.line == line
    assert str(caught.value).endswith("robot.urdf)")


def test_a_document_type_is_refused(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>\n'
    with pytest.raises(FileInputError, match="document type definition"):
        robot(tmp_path, '<link name="&b;"/>', head=bomb)


def test_another_root_element_or_no_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.urdf"
    path.write_text("<sdf/>", encoding="utf-8")
    with pytest.raises(FileInputError, match="<sdf>; expected <robot>"):
        load_robot(path)
    with pytest.raises(FileInputError, match="cannot be read"):
        load_robot(tmp_path / "none.urdf")


def mesh_link(name: str) -> str:
    file = f'<mesh filename="{name}" scale="2 2 2"/>'
    return f'<link name="a"><visual><geometry>{file}</geometry></visual></link>'


def test_meshes_are_found_beside_and_through_packages(tmp_path: Path) -> None:
    box = to_glb(box_mesh(np.ones(3)))
    package = tmp_path / "box_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    (package / "meshes" / "box.glb").write_bytes(box)
    for name in ("../meshes/box.glb", "package://box_description/meshes/box.glb"):
        made = robot(package / "urdf", mesh_link(name))
        np.testing.assert_allclose(made.visuals[0].mesh.extents_m, (2, 2, 2))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    path = elsewhere / "robot.urdf"
    text = mesh_link("package://other/meshes/box.glb")
    path.write_text(f'<robot name="r">{text}</robot>', encoding="utf-8")
    assert load_robot(path, packages={"other": package}).visuals
    assert "'other'" in load_robot(path).warnings[0]


def test_a_missing_or_broken_mesh_is_a_warning(tmp_path: Path) -> None:
    made = robot(tmp_path, mesh_link("none.stl"))
    assert not made.visuals
    assert "'none.stl' does not exist" in made.warnings[0]
    (tmp_path / "bad.stl").write_bytes(b"nothing")
    assert "binary STL" in robot(tmp_path, mesh_link("bad.stl")).warnings[0]


FILE_URL = f"file:{'/' * 3}etc/passwd"


@pytest.mark.parametrize(
    "name", ["../secret.stl", "/etc/passwd", FILE_URL, "http://example.invalid/a.stl"]
)
def test_a_mesh_outside_the_package_folder_is_refused(tmp_path: Path, name: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.stl").write_bytes(b"x")
    with pytest.raises(FileInputError) as caught:
        robot(inner, mesh_link(name))
    assert caught.value.line == 2


def test_a_link_that_leads_out_is_refused(tmp_path: Path) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    (tmp_path / "secret.stl").write_bytes(b"x")
    (inner / "inside.stl").symlink_to(tmp_path / "secret.stl")
    with pytest.raises(FileInputError, match="outside the robot's package folder"):
        robot(inner, mesh_link("inside.stl"))


def test_colours_of_named_materials_reach_the_mesh(tmp_path: Path) -> None:
    inside = """<material name="red"><color rgba="1 0 0 0.5"/></material>
    <link name="a"><visual><origin xyz="0 0 1"/><geometry><sphere radius="1"/></geometry>
    <material name="red"/></visual></link>"""
    visual = robot(tmp_path, inside).visuals[0]
    assert visual.color == (255, 0, 0, 128)
    assert (visual.mesh.face_colors == (255, 0, 0, 128)).all()
    np.testing.assert_allclose(visual.T_link_visual.translation, (0, 0, 1))


TEXT = f"""<?xml version="1.0"?><robot name="r"><link name="a"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><link name="b"/>
{JOINT.format(kind="revolute", more=LIMIT)}</robot>"""


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_damaged_descriptions_load_or_are_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    text = bytearray(TEXT.encode())
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(text)))
        piece = data.draw(st.one_of(st.binary(max_size=4), st.sampled_from([b"nan", b"<", b"b"])))
        text[place : place + data.draw(st.integers(0, 5))] = piece
    path = tmp_path_factory.mktemp("damaged") / "robot.urdf"
    path.write_bytes(text)
    try:
        made = load_robot(path)
    except FileInputError:
        return
    assert all(pose.is_finite() for pose in made.fk({}).values())
