"""Every number that decides something, with its unit and its reason.

A threshold is a field of ``Thresholds``; ``--thresholds FILE.json`` sets any of
them by name. Stages take the object as an argument and never write a deciding
number of their own.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Dict, Mapping

from .errors import UsageError

# No threshold comes near; a whole number beyond 1e308 could not even become a float.
_BEYOND = 1e300


def _number(default: Any, unit: str, why: str) -> Any:
    return field(default=default, metadata={"unit": unit, "why": why})


@dataclass(frozen=True)
class Thresholds:
    """The numbers of the job. ``describe()`` lists them with unit and reason."""

    # --- profiles and intrinsics -------------------------------------------------
    focal_variance: float = _number(
        0.03, "ratio", "(max-min)/mean in a family above which intrinsics are locked: firmware drift starts here"
    )
    focal_split: float = _number(
        0.10, "ratio", "focal centres of one name farther apart than this are two lenses, not drift"
    )
    focal_bin: float = _number(0.02, "ratio", "width of one focal bin of a zoom lens: one camera per bin")
    focal_source_gap: float = _number(
        0.03, "ratio", "ODM's own focal farther than this from a better source gets a cameras file"
    )
    sensor_width_mm: float = _number(
        0.1, "mm", "sensor widths in a family farther apart than this: one of the tags is stale"
    )
    aspect_tolerance: float = _number(
        0.002, "ratio", "sizes whose aspect agrees within this are the same frame scaled, not a crop"
    )
    stored_sigma: float = _number(
        3.0, "sigma", "two surveys' focals this many standard errors apart are of two lenses, or one of them is wrong"
    )
    stored_gap: float = _number(
        0.002, "ratio", "focals of one body closer than this agree: temperature and autofocus move a lens by as much"
    )
    stored_doubts: int = _number(3, "surveys", "so many in a row must contradict a kept calibration, and agree")
    stored_min_frames: int = _number(20, "frames", "a calibration from fewer is not offered to other surveys")
    stored_focal_error: float = _number(
        0.002,
        "ratio",
        "standard error over focal up to which a calibration helps: the height it costs at 100 m is 20 cm",
    )
    intrinsics_disagreement: float = _number(
        0.20, "ratio", "a focal this far from every other source of the same frame is not believed"
    )
    focal_plane_stale: float = _number(
        0.05, "ratio", "focal-plane width this far from the exact sheet: the frame was resized and kept its old tags"
    )
    sensor_width_min_mm: float = _number(0.8, "mm", "no aerial camera has a narrower sensor: the tag is wrong")
    sensor_width_max_mm: float = _number(110.0, "mm", "no aerial camera has a wider sensor: the tag is wrong")
    focal_ratio_min: float = _number(0.15, "ratio", "wider than 147 degrees is no pinhole camera: the tag is wrong")
    focal_ratio_max: float = _number(100.0, "ratio", "narrower than 0.6 degrees: the tag is wrong")
    equivalent_crop_aspect: float = _number(
        1.6, "ratio", "wider stills are cut from a 4:3 sensor and keep the 35 mm equivalent of the whole sensor"
    )
    band_wavelength_nm: float = _number(8.0, "nm", "a band centre within this of the standard is that band")
    thermal_max_megapixels: float = _number(2.0, "MP", "no thermal sensor that flies has more pixels")

    focal_px_min_ratio: float = _number(
        0.1,
        "focal over image width",
        "a calibrated focal without a unit is pixels from here: less would see 157 degrees",
    )

    focal_mm_factor: float = _number(
        2.0, "ratio", "a calibrated focal without a unit within this of the Exif focal is millimetres like it"
    )
    center_margin: float = _number(
        0.25, "of the side", "a calibrated principal point nearer to the edge belongs to another picture size"
    )
    calibrated_size_tolerance: float = _number(
        0.02, "ratio", "a frame within this of the calibrated size is a crop of it, not a reduced one"
    )

    # --- captures and flights ----------------------------------------------------
    capture_time_s: float = _number(2.0, "s", "frames of one DJI capture are written within this time")
    capture_distance_m: float = _number(3.0, "m", "frames of one capture stand at one place within GPS rounding")
    capture_usual_share: float = _number(
        0.9, "ratio", "of a rig's captures, so many show how far apart it writes the times of one trigger"
    )
    capture_spread_slack_s: float = _number(
        0.5, "s", "times under one capture id may differ by this more than the rig's usual spread"
    )
    flight_gap_s: float = _number(
        900.0, "s", "a pause longer than this between frames of a profile starts a new flight"
    )
    flight_gap_m: float = _number(2000.0, "m", "a jump farther than this starts a new flight")
    gps_outlier_m: float = _number(5000.0, "m", "a frame this far from the median of its flight has a wrong position")
    flight_level_gap: float = _number(0.20, "ratio", "heights of one session this far apart are two flights")
    min_level_frames: int = _number(5, "frames", "fewer frames at another height are a climb, not a flight")
    transit_max_frames: int = _number(5, "frames", "take-off and landing leave few frames")
    transit_max_share: float = _number(0.10, "ratio", "or this share of the flight; more is a low flight")
    unknown_footprint_m: float = _number(200.0, "m", "reach of a frame whose height or focal is unknown")
    transit_height_ratio: float = _number(
        0.5, "ratio", "below this share of the flight's median height a frame is take-off or landing"
    )
    panel_height_m: float = _number(5.0, "m", "a panel capture is made by hand near the ground")
    panel_drop_m: float = _number(
        20.0, "m", "GPS altitudes of a rig's still burst so far below its flight are on the ground: four sigma of GPS"
    )
    hover_min_frames: int = _number(5, "frames", "fewer frames at one place are a turn or a stop between two lines")
    hover_radius_m: float = _number(2.0, "m", "frames within this of each other stand at one place")
    hover_radius_ratio: float = _number(
        0.015, "ratio of height", "the same where the height is known, the smaller holds: 98 % overlap, no base line"
    )
    altitude_bias_m: float = _number(
        10.0,
        "m",
        "GPS minus relative altitude of two flights of a site farther apart: twice the vertical spread of GPS",
    )
    oblique_pitch_deg: float = _number(30.0, "degree", "gimbal off nadir by more than this is an oblique frame")
    horizon_pitch_deg: float = _number(80.0, "degree", "gimbal off nadir by more than this looks at the horizon")

    # --- GSD and radiometry ------------------------------------------------------
    gsd_trigger: float = _number(0.05, "ratio", "GSD farther than this from the target is resampled (document's rule)")
    gsd_sigma_factor: float = _number(2.0, "sigma", "a GSD ratio within this many sigma of the height is no difference")
    height_sigma_relative_m: float = _number(2.0, "m", "spread of a barometric height above take-off")
    height_sigma_gps_m: float = _number(5.0, "m", "spread of a plain GPS altitude")
    dem_sigma_share: float = _number(
        0.1,
        "of the cell spacing",
        "spread of an elevation model's heights: 3 m of the public 30 m models, some decimetres of a laser scan",
    )
    dem_sigma_floor_m: float = _number(0.3, "m", "no elevation model is believed below this: plants, ploughing")
    dem_error_cells: float = _number(
        10.0, "cells", "an elevation model's neighbouring cells err together: smoothing, one wood, one slope"
    )
    dem_error_height: float = _number(
        0.5,
        "ratio of height",
        "a free network's own bends are about half a footprint long: nearer heights err together",
    )
    dem_scale_floor: float = _number(
        0.003,
        "ratio",
        "relief tells no scale better: a free network warps by more than tilt and bow (rendered blocks: 0.0 to 0.6 %)",
    )
    dem_min_patches: int = _number(
        6, "patches", "ground in fewer patches that err apart shows an elevation model's errors by chance only"
    )
    dem_grid_nodes: int = _number(
        128, "nodes a side", "of the elevation model are read around a block: a finer grid shows nothing more of relief"
    )
    dem_block_mb: int = _number(256, "MB", "an elevation model stored in larger pieces would have to be read whole")
    ground_min_m: float = _number(-600.0, "m", "no land lies lower, on any datum: such a height is a void")
    ground_max_m: float = _number(9000.0, "m", "no land lies higher: such a height is a void")
    match_hold_ratio: float = _number(
        1.5, "GSD ratio, below 2", "matches of two real surveys hold up to here (+18 % and -37 %, mixed with the fine)"
    )
    match_share_2x: float = _number(0.5, "ratio", "of the matches are left at twice the GSD (measured 0.71 and 0.32)")
    match_share_4x: float = _number(0.17, "ratio", "of the matches are left at four times (measured 0.14 and 0.07)")
    restored_share_2x: float = _number(
        0.9, "ratio", "of the matches, once the coarse frames are enlarged to the fine (measured 1.2 and 0.85)"
    )
    restored_share_4x: float = _number(0.4, "ratio", "the same at four times (measured 0.58 and 0.22)")
    odm_hold_ratio: float = _number(
        1.25, "GSD ratio, below 1.5", "after ODM's own reduction matches hold up to here (measured +24 % and -7 %)"
    )
    odm_share_1_5x: float = _number(
        0.53, "ratio", "of ODM's matches are left at 1.5 times after its own reduction (measured 193 of 361)"
    )
    jpeg_growth: float = _number(
        1.4, "power of the scale", "of an enlarged JPEG's bytes: 1.2 to 1.6 on six real cameras at equal quality"
    )
    upsample_limit: float = _number(4.0, "ratio linear", "beyond this no detail is left that interpolation could serve")
    max_megapixels: float = _number(60.0, "MP", "largest frame that resampling writes")
    max_input_megapixels: float = _number(
        400.0,
        "MP",
        "a frame larger than this is not decoded: twice the largest aerial sensor, and its memory is bounded",
    )
    size_snap: float = _number(
        0.025,
        "ratio",
        "one camera's resampled size this near to its other size becomes that size: half the GSD trigger",
    )
    channel_offset_dn: float = _number(15.0, "DN of 255", "mean channel offset above which histograms are matched")
    tone_pairs: int = _number(
        8, "pairs", "frame pairs of the same ground that a tone comparison reads; more change little"
    )
    tone_min_pairs: int = _number(3, "pairs", "fewer pairs show scenery, not a sensor's offset")
    tone_pair_distance: float = _number(
        0.5, "ratio of radius", "centres nearer than this: the two discs share two thirds of their ground"
    )
    light_pair_distance: float = _number(
        1.0, "ratio of radius", "centres of neighbouring strips; a median over them still shows a drift of the light"
    )
    tone_sample_px: int = _number(400, "px", "shorter side at which tones are read: a mean needs no detail")
    lut_max_slope: float = _number(4.0, "DN per DN", "a steeper table amplifies noise and JPEG blocks")
    jpeg_quality: int = _number(95, "libjpeg quality", "re-encoding loss stays below sensor noise")

    # --- bands of a rig ----------------------------------------------------------
    band_median_px: float = _number(
        1.0, "px of the coarser band", "held-out residual of a warped band, median: beyond, an index mixes neighbours"
    )
    band_p95_px: float = _number(
        3.0, "px of the coarser band", "held-out residual, 95th percentile: beyond, parts of the frame are off"
    )
    band_aligned_px: float = _number(0.5, "px", "bands nearer than this everywhere were aligned before: left alone")
    band_captures: int = _number(
        30, "captures", "sampled per height bin; more do not move a homography of thousands of points"
    )
    band_check_captures: int = _number(
        4, "captures", "of the sample, in which features are matched too, to cross-check"
    )
    band_height_bin: float = _number(
        0.10, "ratio of height", "one homography per bin: parallax of a rig changes by less than a pixel inside it"
    )
    band_features: int = _number(3000, "features", "per band and capture; exact matching then costs 0.5 s per band")
    band_match_dim_px: int = _number(2048, "px", "longer side at which bands are matched: holds most rigs at full size")
    band_match_ratio: float = _number(
        0.8,
        "ratio",
        "Lowe's ratio inside the search radius: 9 of 10 matches of two real rigs agree with one homography",
    )
    band_max_shift: float = _number(
        0.10, "of the longer side", "no rig points its bands farther apart; the next capture of a flight would be"
    )
    band_ransac_px: float = _number(2.0, "px of the coarser band", "control points beyond it do not fit a homography")
    band_outlier_px: float = _number(
        10.0, "px of the coarser band", "held-out points beyond it are false matches and measure nothing"
    )
    band_min_held: int = _number(12, "points", "fewer held-out points prove nothing")
    band_min_share: float = _number(
        0.25, "ratio", "of control points that must agree: chance reaches a few hundredths inside the search radius"
    )
    band_chance_share: float = _number(
        0.05,
        "ratio",
        "a capture whose control points agree no better is another one's: of 20 to 90 matches with wrong captures of a "
        "real flight none agreed, of the fewest of a repetitive right one a sixth",
    )
    band_simpler_cost: float = _number(
        0.05, "ratio", "residual that a model with fewer freedoms may cost: it bends less where there are no points"
    )
    band_min_cover: float = _number(
        0.25, "of the frame's cells", "agreeing points must be spread over at least this: elsewhere the map is a guess"
    )
    band_refine_gain_px: float = _number(
        0.1, "px", "gain on held-out points, median over captures, for which each capture gets its own homography"
    )
    band_area_tile_px: int = _number(40, "px of the coarser band", "window of the gradient comparison")
    band_area_score: float = _number(0.35, "correlation", "a window's best place is believed from here")
    band_area_distinct: float = _number(1.2, "ratio", "and where it beats the next best place by this")
    band_user_points: int = _number(
        6, "points", "the user's control points per band: three fix an affine, the rest test it"
    )

    # --- a look at pixels ----------------------------------------------------------
    look_frames: int = _number(12, "frames", "decoded per colour profile when asked: a conversion shows in every frame")
    look_min_frames: int = _number(3, "frames", "fewer may show one odd field")
    look_side_px: int = _number(192, "px", "longer side of the picture that is looked at: colour shares need no detail")
    look_dark_dn: float = _number(24.0, "DN of 255", "darker pixels have no colour")
    look_blown_dn: float = _number(2.0, "DN of 255", "pixels this near to white are blown out")
    look_min_exposed: float = _number(0.3, "ratio", "a frame with fewer pixels between black and white is not judged")
    look_margin: float = _number(0.06, "ratio", "channels nearer to each other than this are grey: white balance, JPEG")
    look_pink_share: float = _number(
        0.25, "ratio of pixels", "green smallest on a quarter of the ground: no plant or soil does so in visible light"
    )
    look_green_share: float = _number(0.05, "ratio of pixels", "where leaves are green the camera sees visible light")
    look_cast: float = _number(1.3, "ratio", "red over the other channels behind a plain infrared filter")
    look_cast_share: float = _number(0.8, "ratio of pixels", "a cast lies over all of the frame, red soil over a part")
    look_frames_share: float = _number(0.6, "ratio of frames", "more than half: the camera is it, not the field")

    # --- fused orthophotos -------------------------------------------------------
    fuse_max_gigapixels: float = _number(20.0, "GP", "a larger grid comes from sites far apart, not from one survey")
    fuse_compare_px: int = _number(3000, "px", "longer side at which two orthophotos are compared")
    fuse_shift_px: float = _number(
        1.0, "px of the coarser raster", "payloads farther apart mix neighbours in every index across them"
    )

    # --- alignment ---------------------------------------------------------------
    min_inliers: int = _number(30, "matches", "verified matches of a pair; no false pair of two surveys reached it")
    max_reproj_error_px: float = _number(
        2.0, "px", "mean reprojection error of an accepted model; necessary, never enough"
    )
    min_registered_share: float = _number(
        0.5, "ratio", "a payload with fewer of its frames in the model is not held by it"
    )
    unplaced_share: float = _number(
        0.1, "ratio", "every tenth frame without a place is more than the block's rim: its product has holes"
    )
    sample_above: int = _number(200, "frames", "a larger block is judged by samples, so that its cost does not grow")
    sample_frames: int = _number(
        150, "frames per pair of payloads", "about ten strips of fifteen: bowing and focal show in a block of this size"
    )
    min_proof_frames: int = _number(6, "frames", "fewer camera centres cannot contradict a similarity: unproven")
    collinear_ratio: float = _number(
        0.03, "ratio", "second over first singular value of the centres below which they are one line"
    )
    gps_sigma_horizontal_m: float = _number(3.0, "m", "plain GPS, horizontal")
    gps_sigma_vertical_m: float = _number(5.0, "m", "plain GPS, vertical")
    altitude_zero_sigma_m: float = _number(
        50.0, "m", "altitudes from another zero than the block's: geoid and ellipsoid lie up to 100 m apart"
    )
    gps_drift_m: float = _number(
        1.0,
        "m",
        "plain GPS drifts by so much over a flight: the plan's scale is known no better than that over its size",
    )
    takeoff_level_m: float = _number(
        0.5, "m", "a frame from the take-off stands this near to what its own relative altitude says above the ground"
    )
    gps_sigma_factor: float = _number(2.0, "sigma", "residual of the fit up to which a payload passes")
    network_sigma_horizontal_px: float = _number(
        3.0, "px of the solved size", "centres of a free network drift by so much ground: RTK cannot be held tighter"
    )
    network_sigma_vertical_px: float = _number(
        5.0, "px of the solved size", "the same in height, where a slight bow of the free network shows"
    )
    rtk_sigma_floor_m: float = _number(0.05, "m", "antenna to camera offset: no RTK residual is believed below this")
    capture_gap_base_m: float = _number(1.0, "m", "capture centres may lie this far apart besides lever arm and motion")
    capture_gap_vertical: float = _number(0.03, "ratio of height", "vertical gap of a capture's centres that is normal")
    capture_readout_s: float = _number(0.1, "s", "shutter and readout differ by at most this inside one capture")
    lever_arm_m: float = _number(0.3, "m", "payloads of one drone hang at most this far apart")
    pairs_per_frame: int = _number(12, "pairs", "pairs tried per frame")
    pairs_cross: int = _number(4, "pairs", "of those, at least these to other profiles or flights")
    pairs_strip: int = _number(2, "pairs", "of those, at least these to neighbouring strips")
    overlap_sigma_factor: float = _number(
        3.0, "sigma", "footprints farther apart than their radii plus this cannot overlap"
    )
    all_pairs_limit: int = _number(60, "frames", "up to this many frames without GPS every pair is tried")
    retrieval_pairs: int = _number(30, "pairs", "tried by likeness before a payload is isolated")
    min_strong_pairs: int = _number(
        3, "pairs", "pairs of min_inliers that must tie a payload to the others: one or two may be repeated texture"
    )
    fallback_focal_ratio: float = _number(
        0.85, "focal / width", "first guess where no tag or sheet knows the focal; always solved, never held"
    )
    align_max_dim_px: int = _number(
        1200,
        "px",
        "longer side in the quick rung. Measured on 4000 x 2250 frames, one core: 0.37 s/frame and about 140 verified "
        "matches per neighbour pair; 1600 px from a doubled first octave costs 2.5 s for 370; both place 18 of 18",
    )
    align_upsample_below_px: int = _number(
        900, "px", "frames whose longer side is smaller start SIFT from a doubled image: they have few features"
    )
    quick_peak_threshold: float = _number(0.0067, "contrast", "quick rung: COLMAP's own, 0.02 over three layers")
    quick_max_ratio: float = _number(
        0.80, "ratio", "quick rung: Lowe's ratio; no false pair of two surveys reached 15 matches at it"
    )
    mixed_max_dim_px: int = _number(1600, "px", "longer side in the mixed rung: more detail for the hard pairs")
    align_max_features: int = _number(
        3072,
        "features",
        "cap of the quick rung, largest scales first. Measured beside 4096 on 30 well-textured frames: 175 of 178 pairs "
        "verified with both, both place all, matching 0.13 s per pair instead of 0.21",
    )
    reference_max_features: int = _number(
        8192, "features", "COLMAP's own cap, for what came out close to a limit with the quick rung's features"
    )
    mixed_peak_threshold: float = _number(0.003, "contrast", "mixed block: admits weaker extrema than COLMAP's 0.0067")
    mixed_max_features: int = _number(12000, "features", "mixed block: coarse frames find partners among more")
    mixed_max_ratio: float = _number(0.85, "ratio", "mixed block: Lowe's ratio")
    filter_max_reproj_error_px: float = _number(4.0, "px", "mixed block: observations beyond it are dropped")
    affine_iterations: int = _number(5000, "iterations", "RANSAC across spectra")
    bowing_sigma: float = _number(3.0, "standard errors", "bowing is called only beyond this many")
    held_reproj_cost: float = _number(0.10, "ratio", "reprojection error that holding a trusted calibration may cost")
    height_veto_m: float = _number(2.0, "m", "a candidate whose height misses the relative altitude by more is vetoed")
    height_veto_sigma_m: float = _number(
        4.0, "m", "a flown height known worse (GPS minus ground, relief without a take-off) rules no candidate out"
    )
    height_veto_ratio: float = _number(0.05, "ratio", "the same as a share of the height; the larger holds")
    oblique_view_deg: float = _number(15.0, "degree", "views tilted by more than this help to fix a focal")
    oblique_share: float = _number(0.1, "ratio of frames", "so many tilted views support a self-calibration")
    two_heights_ratio: float = _number(
        0.2, "ratio of height", "camera heights spread by this much can show a focal's error in their differences"
    )
    flight_offset_share: float = _number(
        0.2, "ratio of the climb", "no focal is so far off: a flight that lies higher by more counts from another zero"
    )
    camera_moved: float = _number(
        0.001, "ratio", "another profile's camera that moved less leaves a candidate's trial as it was"
    )
    solved_focal_sigma: float = _number(3.0, "sigma", "solved focals this far apart, and 1 %, are two cameras")
    solved_focal_gap: float = _number(0.01, "ratio", "solved focals closer than this are one camera")

    conversion_error_px: float = _number(
        0.05, "px", "a lens model said in another's terms may move no pixel by more: a tenth of what matching resolves"
    )

    # --- ground control ----------------------------------------------------------
    control_fit_m: float = _number(
        0.5, "m", "residual of control points up to which they tie a payload: marks in shrunk frames are a few px wide"
    )
    gcp_mark_px: float = _number(
        10.0, "px of the working size", "a mark that misses where the point's other marks meet by more is on another target"
    )  # fmt: skip
    gcp_astray_share: float = _number(
        0.1, "ratio of marks", "where more of them miss each other, not the marks are wrong but the model"
    )
    control_fit_height: float = _number(
        0.02, "ratio of height", "the same as a share of the height: a free network bows by so much before it is held"
    )
    control_bow_points: int = _number(
        8, "points", "a bow by point heights takes four freedoms; fewer points tell it from noise by chance only"
    )
    gcp_min_points: int = _number(5, "points", "fewer cannot replace the GPS that ODM then switches off")
    gcp_min_images: int = _number(3, "images", "a point in fewer images is not fixed in height")
    gcp_same_mark_px: float = _number(
        1.0, "px", "two marks of a point on one image this close say the same; nobody clicks more exactly"
    )
    gcp_hull_share: float = _number(0.30, "ratio of block area", "points over a smaller part let the rest tilt")
    gcp_min_points_without_gps: int = _number(3, "points", "a similarity needs three where there is no GPS to lose")
    accuracy_ratio: float = _number(2.0, "ratio", "position spreads farther apart than this must not be weighted alike")
    gcp_far_m: float = _number(1000.0, "m", "no survey frame sees a point this far from its own position")
    max_text_bytes: int = _number(16 * 1024 * 1024, "bytes", "a gcp_list.txt or geo.txt larger than this is not read")

    # --- what ODM would do -------------------------------------------------------
    odm_lost_share: float = _number(0.10, "ratio of frames", "ODM leaving out more than this leaves holes in the map")

    # --- reading what ODM made -----------------------------------------------------
    outcome_json_bytes: int = _number(256 * 1024 * 1024, "bytes", "logs and reports of ten thousand frames stay below")
    outcome_value_chars: int = _number(4 * 1024 * 1024, "characters", "one shot or point of a model is never longer")
    outcome_match_bytes: int = _number(256 * 1024 * 1024, "bytes", "matches of one frame with a thousand others")
    outcome_max_models: int = _number(1000, "models", "a survey in more pieces is no survey")
    outcome_max_frames: int = _number(100_000, "frames", "more than any node takes")
    outcome_max_points: int = _number(20_000_000, "points", "of twenty-four bytes each; a larger model is sampled")
    outcome_max_observations: int = _number(200_000_000, "observations", "a bound on time, not on memory")
    outcome_console_lines: int = _number(2_000_000, "lines", "more console than any run of ODM writes")
    outcome_outlier_px: float = _number(4.0, "px", "observations within it always count, as in ODM's own mean")
    outcome_outlier_medians: float = _number(
        5.0, "medians", "a camera's observations beyond this are mismatches: 1 in 100,000 of normal errors is"
    )
    outcome_outlier_share: float = _number(
        0.15, "ratio", "more mismatches are the model's fault and count; two real blocks that hold had 4 to 5 %"
    )
    outcome_ground_points: int = _number(50_000, "points", "as many tell the ground below the cameras; more cost time")
    outcome_focal_change: float = _number(
        0.03, "ratio", "a focal that ODM moved farther from its start: the start was wrong or the block too weak"
    )
    outcome_tie_points: int = _number(10, "points", "OpenSfM takes a frame into a model from ten common points on")

    # --- submitting to a node ------------------------------------------------------
    submit_max_sends: int = _number(3, "uploads", "a project whose upload fails this often fails for a reason")
    submit_max_reroutes: int = _number(2, "tries", "pairwise, then isolated: what fails after that needs a person")
    submit_connect_timeout_s: float = _number(10.0, "s", "a node that is there takes a connection sooner")
    submit_call_timeout_s: float = _number(60.0, "s", "a loaded node was seen to answer within seconds, never a minute")
    submit_upload_timeout_s: float = _number(300.0, "s", "a field link may stall this long within one file")
    submit_patience_s: float = _number(1800.0, "s", "a node that is restarted or out of radio range comes back sooner")
    submit_settle_s: float = _number(3600.0, "s", "a cluster forwards ten thousand frames to its node within the hour")
    submit_lost_answers: int = _number(3, "answers", "a cluster forgets a task for a moment while it hands it over")
    submit_poll_s: float = _number(3.0, "s", "a task takes minutes to hours; the console costs nothing at this pace")
    submit_retry_s: float = _number(2.0, "s", "first wait after a call without an answer; it doubles up to a minute")
    submit_seed_tries: int = _number(6, "uploads", "the archive that mends an upload may be sent again without harm")
    submit_upload_threads: int = _number(6, "files", "more at once gained nothing on a loopback node")
    submit_tasks_at_once: int = _number(8, "tasks", "a cluster names no number of slots; more at once only wait there")
    submit_task_numbers: int = _number(50, "tasks", "so many tasks of one project on a node are no accident")
    submit_answer_bytes: int = _number(64 * 1024 * 1024, "bytes", "an answer that is larger is no answer of a node")
    submit_asset_bytes: int = _number(500 * 1000**3, "bytes", "no product of a survey is larger")
    submit_asset_files: int = _number(5_000_000, "files", "tiles of ten thousand frames stay below")
    submit_disk_reserve_bytes: int = _number(1000**3, "bytes", "a disk is not filled to its last byte")
    submit_retry_features: int = _number(20000, "features", "twice ODM's own number, for a block that did not hold")

    # --- ahead of ODM on a node ------------------------------------------------------
    node_grace_s: float = _number(20.0, "s", "ODM ends its own programs within seconds; what is left then is killed")
    node_lock_wait_s: float = _number(60.0, "s", "the earlier run of a restarted task ends within its grace")
    node_silence_s: float = _number(30.0, "s", "a person at the console takes longer silence for a standstill")
    node_calibration_bytes: int = _number(1024 * 1024, "bytes", "a cameras file of a hundred cameras stays below")
    node_gate_percent: float = _number(2.0, "%", "of a task's progress after the gate; ODM's first stage ends at 5")
    node_ahead_percent: float = _number(4.0, "%", "of a task's progress when ODM starts")

    # --- input bounds ------------------------------------------------------------
    max_xmp_bytes: int = _number(4 * 1024 * 1024, "bytes", "an XMP packet larger than this is not read")
    max_xmp_properties: int = _number(20000, "elements", "an XMP packet with more is no camera's and is not parsed")
    parallel_read_files: int = _number(800, "files", "beyond, two processes read faster than they take to start")
    max_ifd_entries: int = _number(4096, "entries", "a directory with more is damaged")

    def replaced(self, changes: Mapping[str, Any]) -> "Thresholds":
        """Return a copy with ``changes``; an unknown name or a wrong type is a ``UsageError``."""
        known = {f.name: f for f in dataclasses.fields(self)}
        clean: Dict[str, Any] = {}
        for name, value in changes.items():
            if name not in known:
                raise UsageError(f"There is no threshold named {name!r}. Known names: {', '.join(sorted(known))}.")
            number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not number or not abs(value) < _BEYOND:
                raise UsageError(f"Threshold {name!r} needs a finite number, not {value!r}.")
            whole = isinstance(known[name].default, int)
            if whole and value != int(value):
                raise UsageError(f"Threshold {name!r} needs a whole number, not {value!r}.")
            clean[name] = int(value) if whole else float(value)
        return dataclasses.replace(self, **clean)

    @classmethod
    def describe(cls) -> Dict[str, Dict[str, Any]]:
        """Name -> default, unit and reason, for the docs and the report."""
        return {
            f.name: {"default": f.default, "unit": f.metadata["unit"], "why": f.metadata["why"]}
            for f in dataclasses.fields(cls)
        }


DEFAULTS = Thresholds()
