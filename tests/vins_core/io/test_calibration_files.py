"""Calibration files of every format give the same numbers, and what is missing is told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tiny_recording import CALIBRATION, CAMERA, T0, T_B_C, VINS_MONO, images, imu, imus, recorded, without, write

from vins_core.errors import CalibrationError, OutputError
from vins_core.geometry import se3
from vins_core.geometry.camera import camera_from_dict, camera_to_dict
from vins_core.io import own_yaml
from vins_core.io.calibration import Settings, read_calibration
from vins_core.io.recording import open_recording
from vins_core.params import Params
from vins_core.params import replace as with_params

FUSION = """%YAML:1.0
imu: 1
num_of_cam: 2
imu_topic: "/imu0"
image0_topic: "/cam0/image_raw"
image1_topic: "/cam1/image_raw"
cam0_calib: "cam0.yaml"
cam1_calib: "cam1.yaml"
image_width: 64
image_height: 48
estimate_extrinsic: 1
body_T_cam0: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [0, 0, 1, 0.1, -1, 0, 0, 0.2, 0, -1, 0, 0.3, 0, 0, 0, 1]
body_T_cam1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [0, 0, 1, 0.2, -1, 0, 0, 0.2, 0, -1, 0, 0.3, 0, 0, 0, 1]
multiple_thread: 1
max_cnt: 150
flow_back: 0
acc_n: 0.08
gyr_n: 0.004
acc_w: 0.00004
gyr_w: 2.0e-6
g_norm: 9.81
estimate_td: 1
td: -0.005
"""

CAMERA_BLOCK = "%YAML:1.0\n---\n" + VINS_MONO[VINS_MONO.index("model_type") : VINS_MONO.index("estimate_extrinsic")]

FISHEYE_BLOCK = """%YAML:1.0
---
model_type: KANNALA_BRANDT
image_width: 64
image_height: 48
projection_parameters:
   k2: 0.01
   k3: -0.002
   k4: 0.0003
   k5: -0.00004
   mu: 30.0
   mv: 31.0
   u0: 32.0
   v0: 24.0
"""

CAMCHAIN = """cam0:
  T_cam_imu:
  - [0.0, -1.0, 0.0, 0.2]
  - [0.0, 0.0, -1.0, 0.3]
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.2, 0.05, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [40.0, 41.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: 0.0123
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: omni
  distortion_coeffs: [-0.2, 0.05, 0.0001, 0.0002]
  distortion_model: radtan
  intrinsics: [1.4, 90.0, 91.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam1/image_raw
  timeshift_cam_imu: 0.0125
cam2:
  camera_model: pinhole
"""

KALIBR_IMU = """rostopic: /imu0
update_rate: 200.0
accelerometer_noise_density: 0.002
accelerometer_random_walk: 3.0e-3
gyroscope_noise_density: 1.7e-4
gyroscope_random_walk: 2e-5
"""


def config(folder: Path, text: str, name: str = "config.yaml") -> Path:
    (folder / name).write_text(text)
    return folder / name


def read(folder: Path, text: str) -> Settings:
    return read_calibration([config(folder, text)])


# -- VINS-Mono -----------------------------------------------------------------------------------------------------


def test_a_vins_mono_config_is_read(tmp_path: Path) -> None:
    found = read(tmp_path, VINS_MONO).calibration
    assert found.cameras[0].model == CAMERA and found.cameras[0].topic == "/cam0/image_raw"
    assert np.array_equal(found.cameras[0].T_b_c, T_B_C)
    assert (found.noise, found.gravity_m_s2, found.td_s) == (CALIBRATION.noise, 9.81, 0.0)
    assert found.imu_topic == "/imu0"


def test_tuning_keys_become_valid_parameters(tmp_path: Path) -> None:
    overrides = read(tmp_path, VINS_MONO).overrides
    assert overrides == {
        "frontend.max_cnt": 140,
        "frontend.min_dist": 25,
        "frontend.freq": 100.0,
        "frontend.F_threshold": 1.5,
        "frontend.equalize": False,
        "window.keyframe_parallax": 12.0,
        "window.max_iterations": 6,
        "loop.enabled": True,
    }
    assert with_params(Params(), overrides).window.max_iterations == 6


def test_keys_that_change_nothing_are_noted_with_the_reason(tmp_path: Path) -> None:
    notes = read(
        tmp_path, VINS_MONO + "estimate_extrinsic_typo: 2\nfast_relocalization: 0\nvisualize_imu_forward: 1\n"
    ).notes
    for said in (
        "max_solver_time is not used: a run never depends on the clock",
        "fast_relocalization is not used: `loop.relocalize` says how many",
        "estimate_extrinsic_typo is not known and was not used",
    ):
        assert sum(said in note for note in notes) == 1
    assert not any("estimate_td" in note or "visualize" in note for note in notes)


@pytest.mark.parametrize(
    "key", ["imu_topic", "image_topic", "model_type", "image_width", "acc_n", "gyr_w", "g_norm", "td"]
)
def test_a_missing_key_is_told_with_file_and_key(tmp_path: Path, key: str) -> None:
    with pytest.raises(CalibrationError, match=rf"config.yaml: key {key} is missing; expected"):
        read(tmp_path, without(VINS_MONO, key))


@pytest.mark.parametrize(
    ("key", "where"),
    [("k2", "distortion_parameters"), ("fy", "projection_parameters")],
)
def test_a_missing_camera_number_is_told_with_its_place(tmp_path: Path, key: str, where: str) -> None:
    text = "\n".join(line for line in VINS_MONO.splitlines() if line.strip().split(":")[0] != key)
    with pytest.raises(CalibrationError, match=rf"key {where}.{key} is missing"):
        read(tmp_path, text)


def test_a_missing_matrix_is_told(tmp_path: Path) -> None:
    text = VINS_MONO.replace("extrinsicRotation", "extrinsicRotatoin")
    with pytest.raises(CalibrationError, match=r"key extrinsicRotation is missing"):
        read(tmp_path, text)


def test_a_duplicate_key_is_told_with_its_line(tmp_path: Path) -> None:
    last = len(VINS_MONO.splitlines()) + 1
    with pytest.raises(CalibrationError, match=rf'config.yaml, line {last}: found duplicate key "td"'):
        read(tmp_path, VINS_MONO + "td: 0.1\n")


@pytest.mark.parametrize("value", ["fast", "[1, 2]", "true", ".nan", "1,5"])
def test_a_number_that_is_none_is_told(tmp_path: Path, value: str) -> None:
    with pytest.raises(CalibrationError, match=r"key g_norm is .*; expected the norm of gravity"):
        read(tmp_path, without(VINS_MONO, "g_norm") + f"g_norm: {value}\n")


@pytest.mark.parametrize("value", ["0", "-0.08"])
def test_noise_must_be_positive(tmp_path: Path, value: str) -> None:
    with pytest.raises(CalibrationError, match=r"key acc_n is .* greater than zero"):
        read(tmp_path, without(VINS_MONO, "acc_n") + f"acc_n: {value}\n")


def test_a_matrix_that_is_no_rotation_is_refused(tmp_path: Path) -> None:
    text = VINS_MONO.replace("data: [0, 0, 1, -1, 0, 0,", "data: [0, 0, 2, -1, 0, 0,")
    with pytest.raises(CalibrationError, match=r"key extrinsicRotation is no rotation; expected orthonormal rows"):
        read(tmp_path, text)


def test_a_rounded_rotation_is_made_orthonormal(tmp_path: Path) -> None:
    rounded = "0.9553, -0.2955, 0.0, 0.2955, 0.9553, 0.0, 0.0, 0.0, 1.0"
    text = VINS_MONO.replace("0, 0, 1, -1, 0, 0,\n          0, -1, 0", rounded)
    R = read(tmp_path, text).calibration.cameras[0].T_b_c[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert R[0, :2] == pytest.approx([0.9553, -0.2955], abs=1e-4)


def test_an_unknown_camera_model_is_told_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"unknown camera model 'PINHOL'; known are PINHOLE, PINHOLE_FULL, KANN"):
        read(tmp_path, VINS_MONO.replace("model_type: PINHOLE", "model_type: PINHOL"))


def test_opencv_files_may_hold_tabs_and_comments_in_any_encoding(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    text = VINS_MONO.replace("   rows: 3", "   rows: 3\t# Zeilen").encode() + "# 相机".encode("gbk")
    path.write_bytes(text)
    assert read_calibration([path]).calibration.cameras[0].model == CAMERA


# -- VINS-Fusion ---------------------------------------------------------------------------------------------------


def test_a_vins_fusion_config_is_read_with_the_camera_beside_it(tmp_path: Path) -> None:
    config(tmp_path, CAMERA_BLOCK, "cam0.yaml")
    config(tmp_path, FISHEYE_BLOCK, "cam1.yaml")
    found = read(tmp_path, FUSION)
    left, right = found.calibration.cameras
    assert left.model == CAMERA and left.topic == "/cam0/image_raw" and np.array_equal(left.T_b_c, T_B_C)
    assert right.model.name == "kannala-brandt" and right.topic == "/cam1/image_raw"
    assert np.array_equal(right.T_b_c[:3, 3], [0.2, 0.2, 0.3])
    assert found.calibration.td_s == -0.005
    assert found.calibration.estimate_td and found.calibration.extrinsics == "refine"
    assert found.overrides == {
        "frontend.max_cnt": 150,
        "frontend.flow_back": False,
        "frontend.freq": 100.0,  # every image
        "frontend.equalize": False,
        "projection.residual": "sphere",  # the fisheye
    }
    assert any(note.startswith("multiple_thread") for note in found.notes)
    assert not any("not known" in note for note in found.notes)


def test_the_front_end_of_vins_fusion_takes_every_image_as_it_is(tmp_path: Path) -> None:
    """Whatever its config says about that, in which keys that have no effect there are told."""
    config(tmp_path, CAMERA_BLOCK, "cam0.yaml")
    config(tmp_path, CAMERA_BLOCK, "cam1.yaml")
    silent, told = read(tmp_path, FUSION), read(tmp_path, FUSION + "freq: 10\nequalize: 1\n")
    assert silent.overrides == told.overrides and told.overrides["frontend.freq"] == 100.0
    assert not any(note.startswith(("freq", "equalize")) for note in silent.notes)
    assert [note.split()[0] for note in told.notes if "not used: VINS-Fusion" in note] == ["freq", "equalize"]
    assert read(tmp_path, VINS_MONO.replace("equalize: 0", "equalize: 1")).overrides["frontend.equalize"] is True


def test_a_kannala_brandt_camera_is_read(tmp_path: Path) -> None:
    config(tmp_path, FISHEYE_BLOCK, "cam0.yaml")
    config(tmp_path, FISHEYE_BLOCK, "cam1.yaml")
    values = {"fx": 30.0, "fy": 31.0, "cx": 32.0, "cy": 24.0, "k1": 0.01, "k2": -0.002, "k3": 0.0003, "k4": -0.00004}
    expected = camera_from_dict("kannala-brandt", width=64, height=48, **values)
    assert read(tmp_path, FUSION).calibration.cameras[0].model == expected


def test_a_camera_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"cam0.yaml: cannot be read: No such file"):
        read(tmp_path, FUSION)


def test_a_camera_file_alone_is_not_enough(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"describes a camera only; give the VINS config that names it"):
        read(tmp_path, CAMERA_BLOCK)


def test_a_fisheye_mask_is_found_or_its_absence_noted(tmp_path: Path) -> None:
    missing = read(tmp_path, VINS_MONO + 'fisheye: 1\nfisheye_mask_path: "/gone/mask.png"\n')
    assert missing.calibration.cameras[0].mask == ""
    assert any(note.startswith("fisheye: no mask") and "mask.png" in note for note in missing.notes)
    (tmp_path / "fisheye_mask.jpg").write_bytes(b"")
    assert read(tmp_path, VINS_MONO + "fisheye: 1\n").calibration.cameras[0].mask == str(tmp_path / "fisheye_mask.jpg")


# -- Kalibr --------------------------------------------------------------------------------------------------------


def test_kalibr_files_are_read_in_any_order(tmp_path: Path) -> None:
    files = [config(tmp_path, CAMCHAIN, "chain.yaml"), config(tmp_path, KALIBR_IMU, "imu.yaml")]
    for order in (files, files[::-1]):
        found = read_calibration(order)
        camera = found.calibration.cameras[0]
        assert camera.model == CAMERA and camera.topic == "/cam0/image_raw"
        assert found.calibration.td_s == 0.0123, "t_imu = t_cam + timeshift_cam_imu, as ours"
        noise = found.calibration.noise
        assert (noise.kind, noise.acc_n, noise.gyr_n, noise.acc_w, noise.gyr_w) == (
            "continuous",
            0.002,
            1.7e-4,
            3e-3,
            2e-5,
        )
        assert any("no gravity: 9.81 m/s^2 is assumed" in note for note in found.notes)
        assert any(note.startswith("cam2 not used: at most 2") for note in found.notes)


def test_the_second_camera_of_a_chain_has_its_own_place_and_time_shift(tmp_path: Path) -> None:
    files = [config(tmp_path, CAMCHAIN, "chain.yaml"), config(tmp_path, KALIBR_IMU, "imu.yaml")]
    calibration = read_calibration(files).calibration
    left, right = calibration.cameras
    in_left = se3.transform(se3.inverse(left.T_b_c) @ right.T_b_c, np.zeros((1, 3)))
    np.testing.assert_allclose(in_left, [[0.11, 0.0, 0.0]], atol=1e-15)
    assert (calibration.td_of(0), calibration.td_of(1)) == (0.0123, 0.0125)
    assert camera_to_dict(right.model)["model"] == "mei" and camera_to_dict(right.model)["xi"] == 1.4


def test_kalibrs_transform_goes_from_imu_to_camera(tmp_path: Path) -> None:
    files = [config(tmp_path, CAMCHAIN, "chain.yaml"), config(tmp_path, KALIBR_IMU, "imu.yaml")]
    T_b_c = read_calibration(files).calibration.cameras[0].T_b_c
    T_c_b = np.array([[0, -1, 0, 0.2], [0, 0, -1, 0.3], [1, 0, 0, -0.1], [0, 0, 0, 1]])
    assert T_b_c @ T_c_b == pytest.approx(np.eye(4), abs=1e-15)
    assert T_b_c == pytest.approx(T_B_C, abs=1e-15)


def test_kalibrs_result_files_with_an_imu0_section_are_read(tmp_path: Path) -> None:
    nested = "imu0:\n" + "".join(f"  {line}\n" for line in KALIBR_IMU.splitlines())
    found = read_calibration([config(tmp_path, CAMCHAIN, "chain.yaml"), config(tmp_path, nested, "imu.yaml")])
    assert found.calibration.noise.gyr_n == 1.7e-4


@pytest.mark.parametrize(("text", "missing"), [(CAMCHAIN, "its imu file"), (KALIBR_IMU, "its camchain file")])
def test_half_a_kalibr_calibration_asks_for_the_other_half(tmp_path: Path, text: str, missing: str) -> None:
    with pytest.raises(CalibrationError, match=rf"needs {missing} as well; give both with --calib"):
        read(tmp_path, text)


def test_kalibr_models_that_are_not_ours_say_so(tmp_path: Path) -> None:
    chain = CAMCHAIN.replace("camera_model: pinhole\n  distortion_coeffs", "camera_model: ds\n  distortion_coeffs")
    with pytest.raises(CalibrationError, match=r"cam0.camera_model: ds with radtan is not supported; known are pinh"):
        read_calibration([config(tmp_path, chain, "chain.yaml"), config(tmp_path, KALIBR_IMU, "imu.yaml")])


# -- EuRoC ---------------------------------------------------------------------------------------------------------


def euroc_folder(tmp_path: Path) -> Path:
    path = write(tmp_path, [*imus(0, 0.2), *images(0, 0.2)])
    data = ", ".join(str(v) for v in T_B_C.ravel())
    (path / "mav0" / "cam0" / "sensor.yaml").write_text(
        f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\nrate_hz: 20\nresolution: [64, 48]\n"
        "camera_model: pinhole\nintrinsics: [40.0, 41.0, 31.5, 23.5] #fu, fv, cu, cv\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [-0.2, 0.05, 0.0001, 0.0002]\n"
    )
    (path / "mav0" / "imu0" / "sensor.yaml").write_text(
        "sensor_type: imu\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
        "gyroscope_noise_density: 1.6968e-04\ngyroscope_random_walk: 1.9393e-05\n"
        "accelerometer_noise_density: 2.0000e-3\naccelerometer_random_walk: 3.0000e-3\n"
    )
    return path


def test_a_euroc_folder_needs_no_calibration_file_and_notes_the_assumed_gravity(tmp_path: Path) -> None:
    found = read_calibration([], open_recording(euroc_folder(tmp_path)))
    camera = found.calibration.cameras[0]
    assert camera.model == CAMERA and np.array_equal(camera.T_b_c, T_B_C)
    assert (camera.topic, found.calibration.imu_topic) == ("/cam0/image_raw", "/imu0")
    assert found.calibration.noise.kind == "continuous" and found.calibration.noise.gyr_n == 1.6968e-4
    assert any("imu0/sensor.yaml gives no gravity: 9.81 m/s^2 is assumed" in note for note in found.notes)


def test_body_and_imu_may_differ_in_a_euroc_folder(tmp_path: Path) -> None:
    path = euroc_folder(tmp_path)
    imu_file = path / "mav0" / "imu0" / "sensor.yaml"
    imu_file.write_text(imu_file.read_text().replace("[1, 0, 0, 0, 0, 1,", "[1, 0, 0, 0.5, 0, 1,"))
    T_body_imu = np.eye(4)
    T_body_imu[0, 3] = 0.5
    T_b_c = read_calibration([], open_recording(path)).calibration.cameras[0].T_b_c
    assert T_b_c == pytest.approx(se3.inverse(T_body_imu) @ T_B_C, abs=1e-15)


def test_a_folder_without_sensor_files_asks_for_a_calibration(tmp_path: Path) -> None:
    path = euroc_folder(tmp_path)
    (path / "mav0" / "imu0" / "sensor.yaml").unlink()
    with pytest.raises(CalibrationError, match=r"imu0/sensor.yaml: missing, so this folder has no calibration; give"):
        read_calibration([], open_recording(path))


def test_a_bag_asks_for_a_calibration(tmp_path: Path) -> None:
    recording = recorded(tmp_path, [imu(T0)], "ros1")
    with pytest.raises(CalibrationError, match=r"a.bag: a calibration is needed for this recording"):
        read_calibration([], recording)


# -- our own -------------------------------------------------------------------------------------------------------


def test_our_own_file_gives_back_what_was_written_to_the_last_bit(tmp_path: Path) -> None:
    T = T_B_C.copy()
    T[:3, 3] = [1 / 3, -1e-17, 2.5e20]
    awkward = replace(
        CALIBRATION,
        cameras=(replace(CALIBRATION.cameras[0], T_b_c=T),),
        noise=replace(CALIBRATION.noise, kind="continuous", gyr_w=5e-324),
        gravity_m_s2=9.8 + 1e-15,
        td_s=-1 / 7,
    )
    own_yaml.write(tmp_path / "own.yaml", awkward, {"window.max_iterations": 7}, ["a note"])
    found = read_calibration([tmp_path / "own.yaml"])
    camera, given = found.calibration.cameras[0], awkward.cameras[0]
    assert camera.T_b_c.tobytes() == T.tobytes() and camera.model == given.model and camera.topic == given.topic
    assert replace(found.calibration, cameras=(), sources=()) == replace(awkward, cameras=(), sources=())
    assert found.overrides == {"window.max_iterations": 7}
    assert (tmp_path / "own.yaml").read_text().startswith("# a note\n")


def test_our_own_file_needs_gravity(tmp_path: Path) -> None:
    own_yaml.write(tmp_path / "own.yaml", CALIBRATION)
    text = without((tmp_path / "own.yaml").read_text(), "gravity_m_s2")
    with pytest.raises(CalibrationError, match=r"key gravity_m_s2 is missing; expected the norm of gravity"):
        read(tmp_path, text)


def test_our_own_file_refuses_unknown_parameters_and_camera_models(tmp_path: Path) -> None:
    own_yaml.write(tmp_path / "own.yaml", CALIBRATION, {"window.max_iterations": 7})
    text = (tmp_path / "own.yaml").read_text()
    with pytest.raises(CalibrationError, match=r"config.yaml: unknown parameter 'window.max_iteration'"):
        read(tmp_path, text.replace("max_iterations", "max_iteration"))
    with pytest.raises(
        CalibrationError, match=r"cameras\[0\]: unknown camera model 'pinhole'; expected one of pinhole-r"
    ):
        read(tmp_path, text.replace("pinhole-radtan", "pinhole"))


def test_an_existing_calibration_is_not_overwritten(tmp_path: Path) -> None:
    path = config(tmp_path, "precious")
    with pytest.raises(OutputError, match=r"config.yaml: exists already and is not overwritten"):
        own_yaml.write(path, CALIBRATION)
    assert path.read_text() == "precious"


# -- any -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\n", r"unknown calibration format; expected a VINS-Mono or VINS-Fusion config"),
        ("just words", r"expected YAML with `key: value` lines"),
        ("a: [1, 2\nb: 3", r"config.yaml, line \d: not valid YAML"),
        ("a: !!python/object/apply:os.system ['true']\n", r"config.yaml, line 1: not valid YAML: could not determine"),
        ("\x00\x01\x02", r"config.yaml: not valid YAML"),
    ],
)
def test_a_file_that_is_no_calibration_is_told(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(CalibrationError, match=said):
        read(tmp_path, text)


def test_a_calibration_that_does_not_exist_is_told(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"nothing.yaml: cannot be read: No such file"):
        read_calibration([tmp_path / "nothing.yaml"])


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"2000000 bytes; a calibration file has less than"):
        read(tmp_path, "#" * 2_000_000)


def test_topics_left_open_are_taken_from_the_recording(tmp_path: Path) -> None:
    open_topics = replace(CALIBRATION, imu_topic="", cameras=(replace(CALIBRATION.cameras[0], topic=""),))
    own_yaml.write(tmp_path / "own.yaml", open_topics)
    recording = recorded(tmp_path, [*imus(0, 0.2), *images(0, 0.2)], "mcap")
    found = read_calibration([tmp_path / "own.yaml"], recording).calibration
    assert (found.imu_topic, found.cameras[0].topic) == ("/imu0", "/cam0/image_raw/compressed")
