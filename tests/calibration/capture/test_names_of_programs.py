"""Names of frames as cameras, capture programs and filter wheels write them: no number is invented."""

import pytest
from cboxlab.calibration.capture.frame_names import parse_name

#: Kind, filter, exposure and repeat, and names that say these with certainty and no more; "|" separates names.
TABLE = [
    (
        (None, None, None, None),
        "IMG_0550 | IMG_0550-2 | IMG_0550 (2) | IMG_0550_1 | _MG_0550 | DSC_0550 | _DSC0550 | DSC00550 | "
        "DSC_0550_01 | DSCF0550 | _DSF0550 | P1010550 | PA150550 | _A150550 | IMGP0550 | _IGP0550 | L1000550 | "
        "R0000550 | B0000550 | CF000550 | SDIM0550 | SAM_0550 | CIMG0550 | HPIM0550 | DCP_0550 | 100_0550 | "
        "0U8A0550 | 5D3_0550 | 7F4A0550 | XT3_0550 | Z72_0550 | A7R40550 | MVI_0550 | GOPR0550 | G0010550 | "
        "DJI_0550 | DJI_20240512103000_0550_D | IMG_20240512_103000 | IMG_20240512_103000_550 | "
        "IMG_20240512_103000_HDR | PXL_20240512_103000123 | PXL_20240512_103000123.RAW-01.COVER | "
        "20240512_103000 | 20240512_103000_550 | 20240512103000 | WP_20240512_10_30_00_Pro | IMG_E0550 | "
        "IMG_0550-Edit | IMG_0550.CR2 | IMG_0550_0EV | DSC_0550_-1.0EV | DSC_0550_HDR | AEB_0550_1-30s | "
        "20240512-IMG_0550 | Untitled0550 | Capture0001 | Capture_00001 | capture0550 | capt0000 | M31-001Ha | "
        "M31-0001R | Autosave001 | M31.00000123 | M31 300S0X1 | Light_c_cc | 2024-05-12-2210_3-L-Jup_0001 | "
        "2024-05-12-2210_3 | Jup_221030_R_0001 | 22_10_30_F001 | 22_10_30 | 22_10_01 | frame_00001 | "
        "frame-0550 | frame_250 | img_channel000_position000_time000000000_z000 | img_000000000_Default_000 | "
        "MMStack_Pos0.ome | Basler_acA1300-30gm__21234567__20240512_103000123_0001 | "
        "Basler_acA1920-40um__21234567__20240512_103000550_0550 | Image__2024-05-12__10-30-00 | "
        "Image__2024-05-12__10-30-01 | BFS-U3-32S4M-21234567-0550 | image00550 | image_550 | "
        "snapshot_2024-05-12_10-30-00_0550 | X-550 | cube_550 | FB550-10 | FB550-10_4s | FBH550-10 | FL532-1 | "
        "FF01-550-88 | ET550-20x | BN550 | BP550 | bp550-10_1s | 550BP10 | 550FS10-25_4s | 550-10 | filter5 | "
        "pos5 | slot_5 | f8 | f-8_4s | f_550 | LED_550 | laser_532nm_f550 | iPhone 6s IMG_0550 | 1-250 | "
        "f1300 | f0550 | f99 | f550_600nm | t0 | box-2024 | 2024 | 240512_550 | filter_1 | pos_2 | channel_3 | "
        "led_1 | slot_1_4s",
    ),
    (
        (None, None, None, None),
        "DJI_20240512103000_0001_MS_G | DSC00550-2 | P5120550-3 | 3H2A0550-2 | NF550-10 | LP550-2 | IMG_0001_5 | "
        "IMG_240512_103000_0550_NIR | 2024_05_12_IMG_0550 | PXL_20240512_103000550.MP | 20240512_103000_550_iOS | "
        "FLIR0550 | ThorCam-20240512-103000-0001 | img_000000550_Cy3_000 | xy1c2t550 | Series001_t000_z000_ch00 | "
        "spool_0000000550 | pco_00550 | Cam0_0550 | LC08_B5 | lambda_550 | WL=550nm | FELH0550 | MidOpt_BP550 | "
        "Edmund_65-550 | OIII_500.7nm | H-alpha_656.3nm | 50mm_f8_1-60s_ISO100 | AEB1_1-60s | cornell_550_1 | "
        "Experiment-550_c1 | Screenshot 2024-05-12 at 10.30.00 | Jup_EV_1 | IMG_0550_3_of_5",
    ),
    (
        (None, None, 4.0, None),
        "Light_Box_4.0s_Bin1_533MC_gain101_20240512-103000_20.0C_0001 | 59-550_4s | FELH0550_4s | 550DF10_4s | "
        "L_550_ISO800_4s__20C | Box_Light_4_secs_2024-05-12T22-10-30_550 | 20240512-10h30m00s-4s-800iso | "
        "FKB-VIS-10_550_4s",
    ),
    (
        (None, "f550", 4.0, None),
        "22_10_30_00001 550nm 4s | masterLight_BIN-1_6248x4176_EXPOSURE-4.00s_FILTER-f550_mono | f11_550nm_4s | "
        "F5_6_f550_4s | Box_f550_4.000_secs_2024-05-12T10-30-00_001 | Kurios-WB1_550nm_4s | f550_16bit_4s | "
        "LIGHT_f550_4s_BIN1_20C_GA_100_20240512_103000_123_GA_0_OF_10_E",
    ),
    (("dark", None, None, None), "superbias | bias550 | DARK_0550 | dark 550"),
    (("flat", "f550", None, None), "skyflat_f550_001 | flatpanel_550 | FLAT_f550_BIN1_001_20240512_103000_GA_0"),
    ((None, "f550", None, None), "f550_EV-1 | f550_3_of_5 | f550_gain_2 | f550_iso_3 | f550_-1EV | band550_u500"),
    (
        (None, None, 300.0, None),
        "2024-05-12_22-10-30_Ha_-10.00_300.00s_0001 | M31_2x2_300s_L_0001 | "
        "L_M31_2024-05-12_22-10-30_Bin1x1_300s__-10C | M31_Light_Ha_300_secs_2024-05-12T22-10-30_001 | "
        "Light_L_300_secs_001 | Light_M31_300.0s_Bin1_gain100_20240512-221030_-10.0C_0001 | "
        "M31_LIGHT_Ha_300s_BIN1_-10C_001_20240512_221030_123_GA_100_OF_10_E | M31 300s Light 1x1 Ha 00001",
    ),
    ((None, None, 0.25, None), "2024-05-12_22-10-30__-10.00_0.25s_0003"),
    (
        (None, "f550", 4.0, None),
        "2024-05-12_22-10-30_f550_-10.00_4.00s_0001 | VariSpec_550nm_4s | f5.6-f550-4s | 50mm_f550_4s | "
        "gain300_f550_4s | temp_-10C_f550_4s | f550_25C_4s | 3000K_f550_4s | f550 4 sec | f550_300.00_4s | "
        "20240512_550_4s | 12.05.2024_f550_4s | 12-05-2024_f550_4s | 240512_f550_4s",
    ),
    ((None, None, 300.0, 1), "M31_300sec_1x1_Ha_frame1"),
    (("dark", None, 1.0, None), "Dark_1.000_secs_001 | flatdark_1s | darkflat_1s"),
    (("flat", None, 0.25, None), "Flat_Ha_0.250_secs_001"),
    (("flat", "f550", 0.25, None), "Flat_f550_0.250_secs_001"),
    (
        ("dark", None, None, None),
        "Bias_001 | masterDark-BINNING_1-EXPTIME_300.00 | masterBias | dark_1-500 | dark_300 | bias_0s",
    ),
    (("dark", None, 300.0, None), "Dark_300.0s_Bin1_gain100_20240512-221030_-10.0C_0001 | dark_300s"),
    (("flat", "f550", 0.03, None), "Flat_30.0ms_Bin1_f550_gain100_20240512-221030_-10.0C_0001"),
    (("dark", None, 0.001, None), "Bias_1.0ms_Bin1_gain100_20240512-221030_-10.0C_0001"),
    (("flat", "f550", None, None), "masterFlat-FILTER_f550 | flat-1-250-f550 | flat_550 | flat_of_paper_f550"),
    (
        (None, "f550", None, None),
        "scan_0550nm | 550-10_4s | LCTF_550.0nm | 550nm_10nm | filter_5_550nm | iso400_f550 | 100W_f550 | "
        "exp_250_f550 | f550_1_4 s | f550_1e-3s | f550_2.5e-3s | f550_0.5-4s | "
        "f550_0p25s | f550_1,000s | f550_1⁄30s | f550_1over30s | f550_t4s | f550_4s_2s | f550_after_60s | "
        "f550_delay_10s | interval_10s_f550 | iphone_5s_f550 | warmup_30s_f550 | white_f550 | noflat_f550 | "
        "f550 | 550nm | t+30s_f550 | f550_run2 | f550_v2 | f550_pass550 | 2024_f550 | 20240512_f550 | "
        "05_12_24_f550 | 240512_103000_f550 | wheel_2_f550",
    ),
    (
        (None, None, 4.0, None),
        "XBPA550_4s | FW5_4s | wheel3_4s | f8_4s | f2.8_4s | f300mm_4s | ISO_400_4s | 400iso_4s | gain_300_4s | "
        "offset_250_4s | D65_4s | led550_4s | 12V_4s | 1-500_4s | dunkel_4s | 2000nm_4s | f550-f600_4s | R_4s | "
        "Ha_4s",
    ),
    ((None, None, 2.0, None), "F11_2s"),
    ((None, "f550", 0.25, None), "f550_250 ms | f550_0,250s"),
    ((None, "f550", 1.3, None), "f550_1.30s"),
    ((None, "f550", 5.0, None), "f550_5sec"),
    (("flat", None, None, None), "flat_1-500"),
    (("dark", None, 4.0, None), "dark_300_4s | dark4s | Dark Frame 4s"),
    (("dark", None, 4.0, 0), "dark-4s-0"),
    (("dark", None, 4.0, 1), "dark-4s-1"),
    ((None, None, None, 0), "offset_0"),
    (("flat", "f550", 1.0, None), "flat_f550_1s | flat_550_1s"),
    (("flat", "f550", 1.0, 0), "flat-f550-1s-0"),
    ((None, None, 1.0, None), "dark-flat_1s"),
    (("reference", "f450", 2.0, None), "sphere_f450_2s"),
    (("reference", "f550", 1.0, None), "integrating_sphere_f550_1s"),
    (("reference", "f550", None, None), "sphere_550"),
    (("reference", "f650", None, None), "reference_f650"),
    (("target", None, None, 0), "chessboard-0"),
    (("target", None, None, 3), "board_3"),
    ((None, None, None, 3), "onboard_3"),
    (("target", None, None, 1), "charuco_1"),
    (("target", None, None, None), "target_M31"),
    (("target", "f550", None, None), "checkerboard_550"),
    ((None, "f550", 4.0, 0), "box_f550_4s_0"),
    ((None, "f550", 4.0, 1), "box f550 4s (1) | F550_4S_01 | 550_4s_1 | 20240512-f550-4s-1"),
    ((None, "f550", 0.25, 0), "550nm-250ms-0"),
    ((None, "f1050", None, None), "1050nm"),
    ((None, "f450", None, None), "band450"),
    ((None, "f450", 1.0, 2), "band450_1s_2"),
    ((None, None, 4.0, 1), "G_4s_1"),
    ((None, None, 0.5, 1), "L-0.5s-1"),
    ((None, None, 0.02, None), "red_0.02s"),
    ((None, None, None, 1), "open-1"),
    ((None, None, 4.0, 12), "open_4s_12"),
    ((None, "f550", None, 3), "f550_run2_3 | f550_rep3"),
    (
        (None, None, None, None),
        "GFX_0550 | _DSF0550-2 | IMG_0550 2 | LEICA M11_0550 | B0001550 | DSC_0550~2 | X100V_550 | R6_2_0550 | "
        "IMG-20240512-WA0550 | Pixel 7 Pro 0550 | DSC_0550, DSC_0551 | Cornell-001f550 | Capture_00012 22_10_30Z | "
        "Snapshot_2024-05-12_22-10-30_L_4.00_0001 | Moon_120524_221030_R | FilterWheel=4, Exp=2s | кадр_550нм_4с | "
        "box @550nm t=4s | f550.4s | Preview_00001 22_10_30.1234567Z",
    ),
    (
        (None, "f550", 4.0, None),
        "LIGHT_2024-05-12_22-10-30_f550_-10.00_4.00s_0003 | Box_4000ms_f550_0003 | 箱_f550_4s | f550, 4s | "
        "550 nm; 4s | 550 nm, 4 s | f550_4 s",
    ),
    ((None, "f550", 4.0, 2), "550 nm; 4s; 2"),
    ((None, "f550", None, None), "Pos 5 (550 nm) | Box.00000004.f550.LIGHT | 2024-05-12-2210_3-f550-Box"),
    (("dark", None, None, None), "dark.0003 | BIAS_2024-05-12__-10.00_0.00s_0011"),
    (("dark", None, 4.0, 3), "Dark-frames 4s (3)"),
]


@pytest.mark.parametrize(
    ("stem", "said"),
    [(stem, said) for said, stems in TABLE for stem in stems.split(" | ")],
)
def test_a_name_says_no_more_than_is_certain(stem, said):
    name = parse_name(stem)
    assert (name.kind, name.filter, name.exposure_s, name.repeat) == said
