# Public names of this module, which reads them here; type checkers do, too.

from fusion_sfdia.detectors.verdicts import Verdict as Verdict
from fusion_sfdia.diagnosis.changes import Alarm as Alarm
from fusion_sfdia.diagnosis.changes import Change as Change
from fusion_sfdia.diagnosis.device_health import DeviceHealth as DeviceHealth
from fusion_sfdia.diagnosis.events import Event as Event
from fusion_sfdia.diagnosis.events import ProcessEvent as ProcessEvent
from fusion_sfdia.diagnosis.events import UndecidedEvent as UndecidedEvent
from fusion_sfdia.diagnosis.model_health import Health as Health
from fusion_sfdia.diagnosis.watch import Sample as Sample
from fusion_sfdia.diagnosis.watch import WatchWarning as WatchWarning
