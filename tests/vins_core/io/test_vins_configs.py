"""Configs of VINS-Mono, VINS-Fusion, VINS-RGBD and OpenVINS for every kind of camera, as they are published."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from same import differences
from tiny_recording import CALIBRATION, T0, VINS_MONO, gps, images, imus, in_time_order, recorded, without

from vins_core.errors import CalibrationError
from vins_core.geometry import se3
from vins_core.geometry.camera import MODELS, camera_to_dict
from vins_core.io import modes, own_yaml
from vins_core.io.calibration import Settings, read_calibration
from vins_core.io.recording import open_recording
from vins_core.io.write import write_recording
from vins_core.params import Params
from vins_core.record.header import RunHeader, from_json, to_json
from vins_core.sensors import NO_IMU, Calibration, DepthCalibration

BLOCKS = {
    "mei": """model_type: MEI
camera_name: camera
image_width: 64
image_height: 48
mirror_parameters:
   xi: 1.4456544769803834e+00
distortion_parameters:
   k1: -3.4363053357673362e-01
   k2: 6.2347376791548004e-02
   p1: 1.2608078788285675e-03
   p2: -2.1374139252651483e-04
projection_parameters:
   gamma1: 89.5
   gamma2: 89.7
   u0: 32.2
   v0: 23.8
""",
    "pinhole-rational": """model_type: PINHOLE_FULL
camera_name: camera
image_width: 64
image_height: 48
distortion_parameters:
   k1: 0.5158
   k2: -2.6033
   k3: 1.5076
   k4: 0.3946
   k5: -2.4277
   k6: 1.4353
   p1: 0.000498
   p2: -0.000227
projection_parameters:
   fx: 61.2
   fy: 61.3
   cx: 32.2
   cy: 23.8
""",
    "scaramuzza": """model_type: scaramuzza
camera_name: pal
image_width: 64
image_height: 48
poly_parameters:
   p0: -24.6
   p1: 0.000000e+00
   p2: 2.001880e-02
   p3: -3.074460e-04
   p4: 6.138370e-06
inv_poly_parameters:
   p0: 37.8
   p1: 24.8
affine_parameters:
   ac: 0.999993
   ad: -0.000002
   ae: 0.000025
   cx: 30.5
   cy: 23.1
""",
    "kannala-brandt": """model_type: KANNALA_BRANDT
camera_name: camera
image_width: 64
image_height: 48
projection_parameters:
   k2: 1.7e-02
   k3: -2.5e-02
   k4: 2.2e-02
   k5: -7.3e-03
   mu: 27.7
   mv: 27.6
   u0: 33.6
   v0: 23.6
""",
}
PINHOLE_BLOCK = VINS_MONO[VINS_MONO.index("model_type") : VINS_MONO.index("estimate_extrinsic")]

KITTI_FUSION = """%YAML:1.0

imu: 0
num_of_cam: 2

imu_topic: ""
image0_topic: ""
image1_topic: ""
output_path: "~/output/"
cam0_calib: "cam.yaml"
cam1_calib: "cam.yaml"
image_width: 64
image_height: 48
estimate_extrinsic: 0
body_T_cam0: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
body_T_cam1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [1, 0, 0, 0.537165718864418, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
multiple_thread: 0
max_cnt: 200
min_dist: 30
freq: 10
F_threshold: 1.0
show_track: 1
flow_back: 1
max_solver_time: 0.08
max_num_iterations: 10
keyframe_parallax: 15
"""

ESTIMATOR = """%YAML:1.0 # need to specify the file type at the top!
verbosity: "INFO"
use_fej: true
use_stereo: true
max_cameras: 2
calib_cam_extrinsics: true
calib_cam_timeoffset: true
gravity_mag: 9.79
num_pts: 200
min_px_dist: 10
track_frequency: 21.0
histogram_method: "HISTOGRAM"
use_mask: false
relative_config_imu: "kalibr_imu_chain.yaml"
relative_config_imucam: "kalibr_imucam_chain.yaml"
"""
IMUCAM_CHAIN = """%YAML:1.0

cam0:
  T_imu_cam: #rotation from camera to IMU R_CtoI, position of camera in IMU p_CinI
    - [0.0, 0.0, 1.0, 0.1]
    - [-1.0, 0.0, 0.0, 0.2]
    - [0.0, -1.0, 0.0, 0.3]
    - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [40.0, 41.0, 31.5, 23.5] #fu, fv, cu, cv
  resolution: [64, 48]
  rostopic: /cam0/image_raw
cam1:
  T_imu_cam:
    - [0.0, 0.0, 1.0, 0.1]
    - [-1.0, 0.0, 0.0, 0.1]
    - [0.0, -1.0, 0.0, 0.3]
    - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.01, 0.002, 0.0003, 0.0004]
  distortion_model: equidistant
  intrinsics: [40.0, 41.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam1/image_raw
"""
IMU_CHAIN = """%YAML:1.0
imu0:
  T_i_b:
    - [1.0, 0.0, 0.0, 0.0]
    - [0.0, 1.0, 0.0, 0.0]
    - [0.0, 0.0, 1.0, 0.0]
    - [0.0, 0.0, 0.0, 1.0]
  accelerometer_noise_density: 2.0000e-3
  accelerometer_random_walk: 3.0000e-3
  gyroscope_noise_density: 1.6968e-04
  gyroscope_random_walk: 1.9393e-05
  rostopic: /imu0
  time_offset: 0.0
  update_rate: 200.0
  model: "kalibr"
  Tw:
    - [ 1.01, 0.0, 0.0 ]
    - [ 0.0, 1.0, 0.0 ]
    - [ 0.0, 0.0, 1.0 ]
"""


def read(folder: Path, text: str, **others: str) -> Settings:
    for name, content in others.items():
        (folder / f"{name}.yaml").write_text(content)
    (folder / "config.yaml").write_text(text)
    return read_calibration([folder / "config.yaml"])


def with_camera(block: str) -> str:
    return VINS_MONO.replace(PINHOLE_BLOCK, block)


# -- camera models -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", BLOCKS)
def test_every_camera_of_camodocal_is_read_in_a_mono_config(tmp_path: Path, model: str) -> None:
    found = read(tmp_path, with_camera(BLOCKS[model]))
    camera = found.calibration.cameras[0].model
    assert camera.name == model and (camera.width, camera.height) == (64, 48)
    assert not any("not known" in note for note in found.notes)
    centre = np.array([[32.0, 24.0]])
    np.testing.assert_allclose(camera.project(camera.lift(centre)), centre, atol=1e-9)


@pytest.mark.parametrize("model", BLOCKS)
def test_every_camera_of_camodocal_is_read_beside_a_fusion_config(tmp_path: Path, model: str) -> None:
    found = read(tmp_path, KITTI_FUSION, cam="%YAML:1.0\n---\n" + BLOCKS[model])
    assert {camera.model.name for camera in found.calibration.cameras} == {model}


def test_numbers_land_where_the_models_say(tmp_path: Path) -> None:
    mei = camera_to_dict(read(tmp_path, with_camera(BLOCKS["mei"])).calibration.cameras[0].model)
    assert (mei["xi"], mei["fx"], mei["cy"], mei["p2"]) == (1.4456544769803834, 89.5, 23.8, -2.1374139252651483e-04)
    rational = camera_to_dict(read(tmp_path, with_camera(BLOCKS["pinhole-rational"])).calibration.cameras[0].model)
    assert [rational[f"k{i}"] for i in range(1, 7)] == [0.5158, -2.6033, 1.5076, 0.3946, -2.4277, 1.4353]
    ocam = camera_to_dict(read(tmp_path, with_camera(BLOCKS["scaramuzza"])).calibration.cameras[0].model)
    assert (ocam["p0"], ocam["p4"], ocam["ae"], ocam["cx"]) == (-24.6, 6.138370e-06, 0.000025, 30.5)


@pytest.mark.parametrize(
    ("model", "key", "where"),
    [
        ("mei", "k2", "distortion_parameters.k2"),
        ("mei", "gamma2", "projection_parameters.gamma2"),
        ("pinhole-rational", "k5", "distortion_parameters.k5"),
        ("scaramuzza", "p3", "poly_parameters.p3"),
        ("scaramuzza", "ac", "affine_parameters.ac"),
    ],
)
def test_a_missing_number_of_a_camera_is_told_with_its_place(tmp_path: Path, model: str, key: str, where: str) -> None:
    block = "\n".join(line for line in BLOCKS[model].splitlines() if line.strip().split(":")[0] != key) + "\n"
    with pytest.raises(CalibrationError, match=rf"config.yaml: key {where} is missing"):
        read(tmp_path, with_camera(block))


def test_a_polynomial_that_looks_backwards_is_refused_with_the_file(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"config.yaml: .*scaramuzza: p0=24.6; expected less than 0"):
        read(tmp_path, with_camera(BLOCKS["scaramuzza"].replace("p0: -24.6", "p0: 24.6")))


def test_a_lens_that_looks_far_off_its_axis_gets_the_residual_on_the_sphere(tmp_path: Path) -> None:
    wide, narrow = read(tmp_path, with_camera(BLOCKS["scaramuzza"])), read(tmp_path, VINS_MONO)
    assert wide.overrides["projection.residual"] == "sphere" and "projection.residual" not in narrow.overrides
    assert any("degrees off its axis: projection.residual is sphere" in note for note in wide.notes)
    own_yaml.write(tmp_path / "own.yaml", wide.calibration, {"projection.residual": "plane"})
    assert read_calibration([tmp_path / "own.yaml"]).overrides["projection.residual"] == "plane", "the file wins"


# -- modes ---------------------------------------------------------------------------------------------------------


def test_a_stereo_config_without_imu_and_topics_is_read(tmp_path: Path) -> None:
    found = read(tmp_path, KITTI_FUSION, cam=PINHOLE_BLOCK).calibration
    assert not found.has_imu and found.noise == NO_IMU and found.imu_topic == ""
    left, right = found.cameras
    baseline = se3.inverse(left.T_b_c) @ right.T_b_c
    assert baseline[0, 3] == 0.537165718864418 and (left.topic, right.topic) == ("", "")


def test_a_second_camera_that_is_not_described_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"config.yaml: key cam1_calib is missing"):
        read(tmp_path, without(KITTI_FUSION, "cam1_calib"), cam=PINHOLE_BLOCK)
    with pytest.raises(CalibrationError, match=r"config.yaml: key num_of_cam is 3; expected 1 or 2"):
        read(tmp_path, KITTI_FUSION.replace("num_of_cam: 2", "num_of_cam: 3"), cam=PINHOLE_BLOCK)


def test_with_an_imu_topics_and_noise_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"key imu_topic is ; expected|key image0_topic is ; expected"):
        read(tmp_path, KITTI_FUSION.replace("imu: 0", "imu: 1"), cam=PINHOLE_BLOCK)


def test_rolling_shutter_td_and_extrinsics_are_read_as_flags(tmp_path: Path) -> None:
    text = VINS_MONO.replace("estimate_td: 0", "estimate_td: 1").replace(
        "estimate_extrinsic: 0", "estimate_extrinsic: 1"
    )
    found = read(tmp_path, text + "rolling_shutter: 1\nrolling_shutter_tr: 0.033\n")
    calibration = found.calibration
    assert calibration.estimate_td and calibration.extrinsics == "refine"
    assert calibration.cameras[0].readout_s == 0.033
    given = read(tmp_path, VINS_MONO).calibration.td_s  # VINS' td is that of the middle row, ours of the first
    assert calibration.td_s == pytest.approx(given - 0.0165)
    off = read(tmp_path, VINS_MONO + "rolling_shutter: 0\nrolling_shutter_tr: 0.033\n").calibration
    assert off.cameras[0].readout_s == 0.0 and off.extrinsics == "fixed" and not off.estimate_td


def test_unknown_extrinsics_need_not_be_in_the_file(tmp_path: Path) -> None:
    """VINS-Mono's euroc_config_no_extrinsic.yaml with estimate_extrinsic 2."""
    start, end = VINS_MONO.index("extrinsicRotation"), VINS_MONO.index("max_cnt")
    text = (VINS_MONO[:start] + VINS_MONO[end:]).replace("estimate_extrinsic: 0", "estimate_extrinsic: 2")
    found = read(tmp_path, text).calibration
    assert found.extrinsics == "unknown" and np.array_equal(found.cameras[0].T_b_c, np.eye(4))
    with pytest.raises(CalibrationError, match=r"key extrinsicRotation is missing"):
        read(tmp_path, text.replace("estimate_extrinsic: 2", "estimate_extrinsic: 1"))
    with pytest.raises(CalibrationError, match=r"key estimate_extrinsic is 3; expected 0 .* 1 .* or 2"):
        read(tmp_path, text.replace("estimate_extrinsic: 2", "estimate_extrinsic: 3"))


def test_unknown_extrinsics_of_two_cameras_are_refused_unless_their_place_beside_each_other_is_given(
    tmp_path: Path,
) -> None:
    (tmp_path / "cam.yaml").write_text(PINHOLE_BLOCK)
    text = KITTI_FUSION.replace("imu: 0", "imu: 1").replace("estimate_extrinsic: 0", "estimate_extrinsic: 2")
    text = text.replace('imu_topic: ""', 'imu_topic: "/imu0"')
    text += "acc_n: 0.1\ngyr_n: 0.01\nacc_w: 0.001\ngyr_w: 1.0e-4\ng_norm: 9.81\ntd: 0.0\n"
    text = text.replace('image0_topic: ""', 'image0_topic: "/a"').replace('image1_topic: ""', 'image1_topic: "/b"')
    calibration = read(tmp_path, text).calibration
    _, notes = modes.prepare(calibration, "stereo_imu")
    assert any("rotation of cam0 is found before initialising" in note for note in notes)
    first, second = text.index("body_T_cam0"), text.index("body_T_cam1")
    missing = read(tmp_path, text[:first] + text[second:]).calibration  # one alone says nothing
    assert all(np.array_equal(camera.T_b_c, np.eye(4)) for camera in missing.cameras)
    with pytest.raises(CalibrationError, match=r"give body_T_cam0 and body_T_cam1, of which only that is used"):
        modes.prepare(missing, "stereo_imu")
    with pytest.raises(CalibrationError, match=r"give body_T_cam0 and body_T_cam1"):
        modes.prepare(missing, "stereo")
    assert modes.prepare(missing, "mono_imu")


def test_a_depth_config_is_read(tmp_path: Path) -> None:
    """VINS-RGBD: depth registered to colour, in mm; what it draws is of no concern."""
    text = VINS_MONO + (
        'depth_topic: "/camera/aligned_depth_to_color/image_raw"\npcl_dist: 10\nu_boundary: 10\nd_boundary: 10\n'
        "l_boundary: 40\nr_boundary: 40\npcl_min_dist: 0.3\npcl_max_dist: 6\nresolution: 0.02\n"
    )
    found = read(tmp_path, text)
    depth = found.calibration.cameras[0].depth
    assert depth == DepthCalibration("/camera/aligned_depth_to_color/image_raw", scale_m=0.001)
    assert not any("not known" in note for note in found.notes)
    limited = read(tmp_path, text + "depth_min_dist: 0.3\ndepth_max_dist: 8\n").calibration.cameras[0].depth
    assert limited is not None and (limited.min_m, limited.max_m) == (0.3, 8.0)


def test_topic_and_antenna_of_a_gps_receiver_are_read_and_nothing_is_made_up(tmp_path: Path) -> None:
    """The topic and the place are ours: VINS-Fusion's node subscribes to /gps and knows no lever arm."""
    plain = read(tmp_path, VINS_MONO).calibration
    assert (plain.gps_topic, plain.p_b_gps) == ("", None)
    place = "p_b_gps: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [0.6, 0.0, 0.8]\n"
    found = read(tmp_path, VINS_MONO + 'gps_topic: "/fix"\n' + place)
    assert (found.calibration.gps_topic, found.calibration.p_b_gps) == ("/fix", (0.6, 0.0, 0.8))
    assert not any("gps" in note for note in found.notes)
    with pytest.raises(CalibrationError, match="p_b_gps is something else; expected 3 numbers"):
        read(tmp_path, VINS_MONO + "p_b_gps: [0.6, 0.0]\n")


def test_what_a_mono_run_leaves_out_is_noted(tmp_path: Path) -> None:
    text = KITTI_FUSION.replace("imu: 0", "imu: 1").replace("estimate_extrinsic: 0", "estimate_extrinsic: 1")
    text = text.replace('imu_topic: ""', 'imu_topic: "/imu0"').replace('0_topic: ""', '0_topic: "/a"')
    noise = "acc_n: 0.1\ngyr_n: 0.01\nacc_w: 0.001\ngyr_w: 1.0e-4\ng_norm: 9.81\ntd: 0.0\nestimate_td: 1\n"
    full = read(tmp_path, text.replace('1_topic: ""', '1_topic: "/b"') + noise, cam=PINHOLE_BLOCK).calibration
    used, notes = modes.prepare(full)
    assert len(full.cameras) == 2 and used.cameras == full.cameras[:1]
    assert [note for note in notes if ": not used" in note] == ["cam1: not used, mode mono_imu sees by cam0 alone"]
    assert used.estimate_td and used.extrinsics == "refine" and not any("estimate" in note for note in notes)


def test_what_a_calibration_lacks_for_a_mode_is_told(tmp_path: Path) -> None:
    calibration = read(tmp_path, KITTI_FUSION, cam=PINHOLE_BLOCK).calibration
    assert modes.prepare(calibration, "stereo")[0].cameras == calibration.cameras
    with pytest.raises(CalibrationError, match=r"config.yaml: has no IMU, which mode stereo_imu needs"):
        modes.prepare(calibration, "stereo_imu")
    with pytest.raises(CalibrationError, match=r"has one camera, and mode stereo needs two; one camera without an IMU"):
        modes.prepare(modes.restrict(calibration, "mono_imu"), "stereo")


def test_a_second_camera_that_the_recording_lacks_is_noted(tmp_path: Path) -> None:
    (tmp_path / "cam.yaml").write_text(PINHOLE_BLOCK)
    text = KITTI_FUSION.replace('0_topic: ""', '0_topic: "/cam0/image_raw"').replace('1_topic: ""', '1_topic: "/right"')
    (tmp_path / "config.yaml").write_text(text + 'depth_topic: "/depth"\n')
    recording = recorded(tmp_path, in_time_order([*imus(0, 0.5), *images(0, 0.5)]))
    found = read_calibration([tmp_path / "config.yaml"], recording)
    assert [c.topic for c in found.calibration.cameras] == ["/cam0/image_raw"]
    assert found.calibration.cameras[0].depth is None
    assert any("cam1 not used: the recording has no images of /right" in note for note in found.notes)
    assert any("depth of cam0 not used" in note for note in found.notes)


# -- OpenVINS ------------------------------------------------------------------------------------------------------


def openvins(tmp_path: Path, text: str = ESTIMATOR, imu: str = IMU_CHAIN) -> Settings:
    return read(tmp_path, text, kalibr_imucam_chain=IMUCAM_CHAIN, kalibr_imu_chain=imu)


def test_an_openvins_config_is_read_with_the_chains_beside_it(tmp_path: Path) -> None:
    found = openvins(tmp_path)
    calibration = found.calibration
    left, right = calibration.cameras
    assert np.array_equal(left.T_b_c, CALIBRATION.cameras[0].T_b_c), "T_imu_cam is T_b_c itself"
    assert left.model == CALIBRATION.cameras[0].model and right.model.name == "kannala-brandt"
    assert (calibration.gravity_m_s2, calibration.estimate_td, calibration.extrinsics) == (9.79, True, "refine")
    assert found.overrides == {"frontend.max_cnt": 200, "frontend.min_dist": 10, "frontend.freq": 21.0}
    assert any("Tw not applied" in note for note in found.notes)
    assert any(
        "keys are not used, they belong to OpenVINS' filter: use_fej, use_stereo" in note for note in found.notes
    )
    assert not any("gravity" in note for note in found.notes)


def test_openvins_may_use_one_camera_of_the_chain(tmp_path: Path) -> None:
    found = openvins(tmp_path, ESTIMATOR.replace("max_cameras: 2", "max_cameras: 1"))
    assert len(found.calibration.cameras) == 1
    assert any(note.startswith("cam1 not used: at most 1") for note in found.notes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("gravity_mag: 9.79\n", ""), "config.yaml: key gravity_mag is missing"),
        (("calib_cam_timeoffset: true", "calib_cam_timeoffset: 1"), "key calib_cam_timeoffset is 1; expected true"),
        (("kalibr_imu_chain.yaml", "gone.yaml"), "gone.yaml: cannot be read"),
    ],
)
def test_a_fault_in_an_openvins_config_is_told(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        openvins(tmp_path, ESTIMATOR.replace(*change))


# -- what is read can be kept --------------------------------------------------------------------------------------


def everything(tmp_path: Path) -> Calibration:
    """A calibration with every optional part."""
    (tmp_path / "cam.yaml").write_text(BLOCKS["mei"])
    (tmp_path / "config.yaml").write_text(
        KITTI_FUSION.replace("imu: 0", "imu: 0\nrolling_shutter: 1\nrolling_shutter_tr: 0.02")
    )
    left, right = read_calibration([tmp_path / "config.yaml"]).calibration.cameras
    left = replace(left, depth=DepthCalibration("/depth", 2e-4, 0.1, 9.0, 0.01), topic="/left")
    return replace(
        CALIBRATION,
        cameras=(left, replace(right, td_s=-1 / 3, topic="/right")),
        estimate_td=True,
        extrinsics="unknown",
        gps_topic="/fix",
        p_b_gps=(1 / 3, -0.1, 1.0),
    )


@pytest.mark.parametrize("has_imu", [True, False])
def test_a_calibration_survives_our_own_file_and_the_header_of_a_run(tmp_path: Path, has_imu: bool) -> None:
    calibration = everything(tmp_path)
    if not has_imu:
        calibration = replace(calibration, has_imu=False, noise=NO_IMU, imu_topic="", estimate_td=False)
    own_yaml.write(tmp_path / "own.yaml", calibration)
    found = read_calibration([tmp_path / "own.yaml"]).calibration
    assert differences(replace(found, sources=calibration.sources), calibration) == []
    recorded_one = from_json(to_json(RunHeader(Params(), calibration)), "here").calibration
    assert differences(recorded_one, calibration) == []


@pytest.mark.parametrize("model", ["pinhole-radtan", *BLOCKS])
def test_every_camera_survives_a_euroc_folder(tmp_path: Path, model: str) -> None:
    block = PINHOLE_BLOCK if model == "pinhole-radtan" else BLOCKS[model]
    (tmp_path / "config.yaml").write_text(with_camera(block))
    settings = read_calibration([tmp_path / "config.yaml"])
    pair = (
        settings.calibration.cameras[0],
        replace(settings.calibration.cameras[0], name="cam1", topic="/cam1/image_raw"),
    )
    settings = replace(settings, calibration=replace(settings.calibration, cameras=pair))
    messages = in_time_order([*imus(0, 0.3), *images(0, 0.3), *images(0, 0.3, topic="/cam1/image_raw"), gps(T0)])
    folder = open_recording(write_recording(messages, tmp_path / "out", "asl", settings=settings))
    found = read_calibration([], folder).calibration
    assert set(MODELS) == {"pinhole-radtan", *BLOCKS}
    assert [c.model for c in found.cameras] == [c.model for c in pair]
    assert [c.topic for c in found.cameras] == ["/cam0/image_raw", "/cam1/image_raw"]


def test_a_euroc_folder_keeps_what_a_run_shall_estimate(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(with_camera(PINHOLE_BLOCK))
    settings = read_calibration([tmp_path / "config.yaml"])
    asked = replace(settings.calibration, extrinsics="unknown", estimate_td=True)
    messages = in_time_order([*imus(0, 0.3), *images(0, 0.3)])
    out = write_recording(messages, tmp_path / "out", "asl", settings=replace(settings, calibration=asked))
    found = read_calibration([], open_recording(out)).calibration
    assert found.extrinsics == "unknown" and found.estimate_td


def test_a_euroc_folder_keeps_where_the_gps_antenna_is(tmp_path: Path) -> None:
    """In its sensor.yaml, as the place of any other sensor; also where body and IMU differ."""
    (tmp_path / "config.yaml").write_text(with_camera(PINHOLE_BLOCK))
    settings = read_calibration([tmp_path / "config.yaml"])
    messages = in_time_order([*imus(0, 0.3), *images(0, 0.3), gps(T0)])
    bare = write_recording(messages, tmp_path / "bare", "asl", settings=settings)
    assert read_calibration([], open_recording(bare)).calibration.p_b_gps is None
    placed = replace(settings, calibration=replace(settings.calibration, gps_topic="/gps0", p_b_gps=(0.6, -0.1, 1 / 3)))
    out = write_recording(messages, tmp_path / "out", "asl", settings=placed)
    found = read_calibration([], open_recording(out)).calibration
    assert (found.gps_topic, found.p_b_gps) == ("/gps0", (0.6, -0.1, 1 / 3))
    imu_file = out / "mav0" / "imu0" / "sensor.yaml"
    moved = imu_file.read_text().replace("[1.0, 0.0, 0.0, 0.0, 0.0, 1.0,", "[1.0, 0.0, 0.0, 0.5, 0.0, 1.0,")
    assert moved != imu_file.read_text()
    imu_file.write_text(moved)
    assert read_calibration([], open_recording(out)).calibration.p_b_gps == pytest.approx((0.1, -0.1, 1 / 3))
