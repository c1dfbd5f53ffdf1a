"""The names of planview, each imported from here when it is first used."""

from calib.errors import InputError as InputError
from calib.errors import WorkError as WorkError
from calib.pose import SE3 as SE3
from planview.engine.config import Config as Config
from planview.engine.config import load_config as load_config
from planview.engine.engine import Engine as Engine
from planview.engine.engine import FrameResult as FrameResult
from planview.engine.open import engine_of as engine_of
from planview.engine.open import open_engine as open_engine
from planview.engine.setup import set_up as set_up
from planview.evaluation.evaluate import EvaluationParams as EvaluationParams
from planview.evaluation.evaluate import evaluate_tracks as evaluate_tracks
from planview.evaluation.result import Evaluation as Evaluation
from planview.foreground.mixture import Foreground as Foreground
from planview.maps.view import ViewBuilder as ViewBuilder
from planview.output.script import count_tracks as count_tracks
from planview.output.script import evaluate as evaluate
from planview.output.script import load_rules as load_rules
from planview.output.script import run as run
from planview.tracking.base import Decision as Decision
from planview.tracking.base import Observation as Observation
from planview.tracking.base import Tracker as Tracker
from planview.tracking.base import TrackerDebug as TrackerDebug
from planview.tracking.ellipse_particle.tracker import EllipseParticleTracker as EllipseParticleTracker
from planview.tracking.human_model.tracker import HumanModelTracker as HumanModelTracker
from planview.tracking.joint import JointTracker as JointTracker
from planview.tracking.template import TemplateTracker as TemplateTracker
from planview.trajectories.state import TrackState as TrackState
from planview.trajectories.table import Trajectories as Trajectories
from planview.trajectories.table import TrajectoryCollector as TrajectoryCollector
from planview.trajectories.table import read_tracks as read_tracks
from planview.trajectories.table import read_truth as read_truth
from stereo.depth import RectifiedGeometry as RectifiedGeometry
from stereo.matcher import Matcher as Matcher
from stereo.matcher import SgbmMatcher as SgbmMatcher
from stereo.readers import OpenOptions as OpenOptions
from stereo.readers import open_recording as open_recording
from stereo.readers import open_video as open_video
from stereo.rectify import Rectifier as Rectifier

__version__: str
