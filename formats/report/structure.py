"""Structure of report.json, run.json and --json output: keys with type, unit and meaning.

A file may contain more keys. `schema_version` grows when a key of a report changes its meaning. Lengths are in
metres, times in seconds, angles in degrees if the key ends in `_deg`. A figure that does not exist is null.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

Share = Annotated[float, Meta(ge=0.0)]
Count = Annotated[int, Meta(ge=0)]
Figure = float | None  # null: no truth, no reading, or division by zero
Interval = tuple[float, float]


class MadeWith(Struct):
    """Versions that affect the last digits of results; with and without compiled kernels these agree to 1e-9."""

    python: str
    machine: str  # kind of CPU
    numpy: str | None
    opencv: str | None
    core: str | None = None  # compiled, or not compiled: slower, equal to 1e-9


class Refused(Struct):
    """Readings of one stream that were not used."""

    readings: Count
    of: Count


class Input(Struct):
    """The log that was read."""

    name: str
    files: list[str]
    size: Count  # bytes
    identity: str  # hash that identifies the content without reading all of it
    sha256: str | None  # of all bytes; null unless all were read
    start: str | None  # time of the first wheel reading, UTC, on the log's clock
    topics: dict[str, Any]  # role -> topic, or topics
    messages: dict[str, Count]  # topic -> messages
    losses: dict[str, Any]  # reason -> places, bytes and messages that could not be read
    refused: dict[str, Refused]  # stream -> readings not used
    dropped: dict[str, dict[str, Count]]  # stream -> reason -> readings not used


class SensorConsistency(Struct):
    """Whether a sensor's configured noise matches its innovations."""

    verdict: str
    words: str  # the verdict as a sentence
    scale: Figure = None  # observed / configured standard deviation
    refused: Figure = None  # share of readings rejected by the gate


class SensorResult(Struct):
    """Counts of one sensor's measurements in one configuration, by verdict."""

    accepted: Count
    rejected: Count
    absent: Count  # readings without a usable measurement
    nis: Figure  # mean normalised innovation squared per degree of freedom: 1 is right
    verdicts: dict[str, Count]  # verdict -> measurements
    joint_nis: Figure = None  # of whole scans, with the correlation of their lines; null for other sensors
    consistency: SensorConsistency | None = None


class CovarianceConsistency(Struct):
    """Whether the claimed covariance matches the error against truth."""

    anees: Figure  # average normalised estimation error squared, per degree of freedom: 1 is right
    bounds: Interval  # 95 % interval of the ANEES of a consistent filter on such a drive
    states: dict[str, Figure]  # ANEES of x, y and theta alone
    words: str


class ReportedReference(Struct):
    """The reference used instead of truth: a smoothed solution of the whole drive."""

    sensors: list[str]  # sensors of the solution, besides the wheels
    left_out: list[str]  # sensors of the log that it does not use
    sigma_m: float  # median over the drive of its position sigma, sqrt(P_xx + P_yy)
    shared: list[str] = []  # sensors of the solution that the judged result uses too
    agrees: bool = True  # with the reference of all sensors, within both covariances
    words: str = ""  # its description, as a sentence


class ReportedJump(Struct):
    """A jump of the estimate: a correction of a wheel slip, a relocalisation or a loop closure."""

    t_s: float
    kind: str  # slip: wheel slip corrected; relocalised: lost robot found; loop: place recognised
    dx_m: float  # map frame
    dy_m: float
    dtheta_deg: float


class SmoothedDistance(Struct):
    """The distance [m] between a filtered path and its smoothed path after rigid alignment."""

    rms: float
    max: float
    t_s: float  # time of the largest distance


class WithoutTruth(Struct):
    """Figures of a path that need no truth."""

    revisit_agreement: Figure = None  # share of a scan's points that lie on an earlier scan of the place
    crispness_cells: Figure = None  # number of 5 cm cells with points of all scans: on one drive fewer is better
    smoothed_distance_m: SmoothedDistance | None = None  # to the smoothed path; null without one
    events: list[ReportedJump] = []  # jumps of the pose


class ReportedResult(WithoutTruth, Struct, kw_only=True):
    """The figures of one configuration, filtered or smoothed."""

    configuration: str  # the set of sensors: "odometry", "compass+lrf", "all"
    smoothed: bool
    align: str  # alignment of the estimate to the truth before its errors: none, origin, se2
    rates_hz: dict[str, float]  # sensor -> reduced rate of its readings
    lost: list[Interval]  # s: intervals in which the filter was lost
    lost_share: Share  # of the drive
    notes: list[str]
    sensors: dict[str, SensorResult]
    position_rmse_m: Figure
    position_mean_m: Figure
    position_median_m: Figure
    position_max_m: Figure
    final_position_error_m: Figure
    x_rmse_m: Figure
    y_rmse_m: Figure
    along_rmse_m: Figure  # along the truth's heading
    cross_rmse_m: Figure  # left of the truth's heading
    heading_rmse_deg: Figure
    heading_max_deg: Figure
    drift_1m: Figure  # relative error over 1 m, as a share
    drift_5m: Figure  # over 5 m
    drift_10m: Figure  # over 10 m
    anees: Figure  # average NEES per degree of freedom: 1 is right; null after alignment
    truth_coverage: Figure  # share of the drive for which there is truth
    duration_s: float  # of the log
    distance_m: float  # length of the estimated path
    consistency: CovarianceConsistency | None = None
    jitter: dict[str, Any] | None = None  # figure -> least and most over runs on jittered drives; path_moved_m
    reference: ReportedReference | None = None  # reference of the errors; null: the truth, or none
    void: Void | None = None  # why error figures are null although they could be computed


class Void(Struct):
    """Figures of a configuration that are not valid, and the reason."""

    reason: str
    figures: dict[str, Figure]  # key -> value


class Validity(Struct):
    """A reason why figures of some configurations are void or doubtful."""

    code: str  # lost: the filter was lost; start: the truth starts elsewhere; else the code of a finding
    message: str
    since_s: float
    configurations: list[str]
    void: bool = True  # false: doubtful, a wrong setting spoils them


class ReportedTrial(Struct):
    """One configuration's figures before or after a fix."""

    position_rmse_m: Figure
    aligned: bool  # error after rigid alignment to the truth, e.g. if only a laser's own map gives positions
    anees: Figure
    prediction_nats: Figure  # nats per number of sensors that were not fused; only without truth
    lost_share: Share  # of the drive
    heading_rmse_deg: Figure


class Tried(Struct):
    """Figures of one configuration of the log, before and after a fix."""

    configuration: str
    before: ReportedTrial
    after: ReportedTrial


class ReportedFinding(Struct):
    """A problem of a log or its settings, and the fix that helps."""

    role: str  # the sensor, or wheels, truth, start
    code: str
    message: str
    fixes: list[str]  # "table.key=value" each; empty: nothing helped
    tried: Tried | None  # null: no fix was found, or it was not tried
    alternatives: list[list[str]]  # fixes that were tried and do not help
    harmless: bool = False  # an alternative changes little; false without a fix: all make the result worse


class ReportedTruth(Struct):
    """The ground truth: topic and extent."""

    topic: str
    stamps: Count
    used: Count
    heading: bool  # whether it has headings
    distance_m: Figure


class Jitter(Struct):
    """Repeated runs on slightly changed drives: the scatter of a figure over them is its random part."""

    runs: Count
    words: str


class Verdict(Struct):
    """The verdict on a sensor: whether it makes the position error smaller."""

    verdict: str  # helps, seems to help, no effect seen, seems to hurt, hurts, no verdict
    words: str


class _Common(Struct):
    schema_version: Literal[1]
    locfuse: str  # version that wrote the report
    made_with: MadeWith
    input: Input
    configurations: dict[str, ReportedResult]  # name -> figures
    truth: ReportedTruth | None
    absent: dict[str, str]  # sensor -> why the log has none
    notes: list[str]
    settings: dict[str, Any]  # the effective robot.toml


class Report(_Common):
    """report.json of `locfuse compare`, run.json of `locfuse run`."""

    doubt: str | None = None  # why the laser's path is doubted, as a sentence
    headline: str | None = None  # the answer in one or two sentences
    findings: list[ReportedFinding] | None = None  # null: the log was not evaluated
    fixes: list[str] | None = None  # all fixes together, "table.key=value" each
    validity: list[Validity] = []  # why figures are void or doubtful
    reference: ReportedReference | None = None  # reference of all sensors, used instead of truth; null: not used
    verdicts: dict[str, Verdict] = {}  # sensor -> verdict; only of a comparison
    credit: dict[str, Any] | None = None  # factors and intervals behind the verdicts
    prediction: dict[str, Any] | None = (
        None  # how well each configuration predicts the sensors that it does not use
    )
    consistency: dict[str, SensorConsistency] = {}  # sensor -> verdict on its noise
    changed_settings: dict[str, dict[str, Any]] = {}  # "table.key" -> value, unit, and who set it
    repeat: str | None = None  # the command that repeats this report
    jitter: Jitter | None = None  # null: not asked for
    key: str | None = None  # equal for equal input, settings, configurations and version
    measured: dict[str, Any] | None = None  # for one of several logs: settings and lags measured on its drive


# --- locfuse info --json


class ListedTopic(Struct):
    """A topic, from the summary of the file."""

    type: str
    messages: Count
    rate_hz: Figure  # mean


class InfoTopic(ListedTopic):
    """Topic with values read from its messages: frame, period, gaps, clock and dropped messages."""

    frame: str | None
    period_s: Figure  # median
    gaps: list[Interval]  # s since the log began: stretches without messages, at most the first few
    longest_gap_s: Figure
    clock: str | None  # clock of its time stamps
    delay_s: Figure  # from stamp to recording
    stamps_repaired: dict[str, Count]  # why -> messages
    dropped: dict[str, Count]  # why -> messages
    problem: str | None  # why it cannot be read


class InfoRole(Struct):
    """The topics of a role (a sensor, wheels or truth)."""

    topics: list[str]
    why: str | None  # reason for the choice


class InfoFinding(Struct):
    """A problem of the log or its settings."""

    role: str  # the sensor, or wheels, truth, start, file, log; or a topic
    code: str
    message: str
    fixes: list[str]  # "table.key=value" each
    source: str | None  # where the values of the fixes come from
    severe: bool  # whether it spoils an estimate or prevents one


class InfoTried(Struct):
    """Results of fusing the log in `info --check`, keys as in report.json; empty if the log cannot be fused."""

    headline: str | None = None
    validity: list[Validity] = []
    findings: list[ReportedFinding] | None = None
    fixes: list[str] | None = None


class InfoFile(Struct):
    """The files of a log, with size, duration and number of messages."""

    name: str
    files: list[str]
    bytes: Count
    duration_s: Figure
    start_ns: int | None
    messages: Count
    checksums: bool  # whether a changed value would be noticed


class InfoOutput(InfoFile):
    """Output of `locfuse info LOG --json` and locfuse.info(LOG)."""

    topics: dict[str, InfoTopic]
    roles: dict[str, InfoRole]  # sensor, wheels or truth -> topics
    absent: dict[str, str]  # sensor or role -> why it cannot be used
    extrinsics: dict[str, dict[str, Any]]  # sensor -> mount [m, degrees] and its source
    configurations: dict[str, str | None]  # name -> what is missing; null: it runs
    findings: list[InfoFinding]
    severe: bool  # whether a finding is severe
    tried: InfoTried | None = None  # null: without --check


class TopicsOutput(Struct, forbid_unknown_fields=True):
    """Output of `locfuse info LOG --topics --json`."""

    topics: dict[str, ListedTopic]


# --- locfuse tune --json


class TunedNoise(Struct):
    """A noise setting before and after tuning, in the unit of its key."""

    before: float
    after: float
    low: Figure  # of the 95 % interval; null where the logs do not show the figure
    high: Figure
    identifiable: bool


class TunedLikelihood(Struct):
    """Log likelihood [nats] per measured number before and after tuning: larger is better."""

    before: Figure
    after: Figure
    numbers: Count


class TunedFigures(Struct):
    """Position error and NIS of a log."""

    position_rmse_m: Figure
    nis: dict[str, Figure]  # sensor -> mean normalised innovation squared: 1 is right


class TunedLog(Struct):
    """Figures of a log before and after tuning."""

    name: str
    before: TunedFigures
    after: TunedFigures


class TuneOutput(Struct):
    """Output of `locfuse tune LOG --json`."""

    noise: dict[str, TunedNoise]  # "table.key" -> figure
    ln_likelihood_per_number: dict[str, TunedLikelihood | None]  # training, held_out
    logs: list[TunedLog]
    measured_again: list[str]  # sensors
    refused: bool  # the found noise makes a log worse and is not used
    robot: dict[str, dict[str, Any]]  # tables of robot.toml to be used
    notes: list[str]


# --- locfuse calibrate --json


class Estimated(Struct):
    """A value with its 95 % interval, in the unit of its key."""

    value: float
    low: float
    high: float


class CalibratedGeometry(Struct, kw_only=True):
    """Wheel radius, ratio of radii and track width; null if the logs do not show them."""

    radius: Estimated | None = None  # m
    ratio: Estimated | None = None  # right radius over left
    track: Estimated | None = None  # m


class CalibratedWheels(CalibratedGeometry, kw_only=True):
    """Wheel calibration from the ground truth."""

    noise_m: Estimated  # wheels.noise
    delta: Estimated  # wheel noise of the article, for steps of delta_period_s
    delta_period_s: float
    ln_likelihood_noise_over_delta: float
    straight_pieces: Count
    turn_pieces: Count
    straight_m: float
    turned_deg: float
    outliers: Count  # pieces of the drive that do not fit the others


class CalibratedLaser(CalibratedGeometry, kw_only=True):
    """Calibration of wheels and laser mount from laser scans."""

    x: Estimated | None = None  # m
    y: Estimated | None = None  # m
    yaw_deg: Estimated | None = None
    time_offset: Estimated | None = None  # s
    pieces: Count
    way_m: float
    turned_deg: float
    outliers: Count


class CalibratedByGyro(CalibratedGeometry, kw_only=True):
    """Calibration of the wheels from the gyro's turns."""

    noise_m: Estimated
    noise_by_window_m: dict[str, float]  # length [s] -> noise
    time_offset_s: float
    turned_deg: float
    windows: Count


class CalibratedIron(Struct):
    """Magnetometer calibration: corrected field = soft_iron @ (field - hard_iron); soft_iron row by row."""

    hard_iron: list[float]
    hard_iron_sigma: list[Figure]
    soft_iron: list[float]
    soft_iron_sigma: list[Figure]
    strength: float  # of the field, in the unit of its messages
    scatter_deg: float
    error_before_deg: float  # rms over a turn
    gap_deg: float  # largest stretch of headings without a reading
    readings: Count


class CalibrateOutput(Struct):
    """Output of `locfuse calibrate LOG --json`; null for values that the logs do not show."""

    wheels: CalibratedWheels | None
    laser: CalibratedLaser | None
    gyro: CalibratedByGyro | None
    compass: CalibratedIron | None
    tricycle: dict[str, Any] | None  # key of wheels, <by>_<key> -> value, interval; by; rms_m, of a gyro rms_deg
    robot: dict[str, dict[str, Any]]  # tables of robot.toml to be used
    notes: list[str]
