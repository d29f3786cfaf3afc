"""What can go wrong on a machine, scripted: each fault knows the findings it must lead to.

`at_s` counts from the start of the run. Findings marked as not required are those that a correct
analyzer may add beside the main one.
"""

from syncline_samples.faults.bus import CableLoose as CableLoose
from syncline_samples.faults.bus import NodeBusOff as NodeBusOff
from syncline_samples.faults.emcy import MAY_TELL as MAY_TELL
from syncline_samples.faults.emcy import Emcy as Emcy
from syncline_samples.faults.emcy import EmcyInhibitTime as EmcyInhibitTime
from syncline_samples.faults.emcy import EmcyMalformed as EmcyMalformed
from syncline_samples.faults.emcy import EmcyStorm as EmcyStorm
from syncline_samples.faults.emcy import EmcyWhileStopped as EmcyWhileStopped
from syncline_samples.faults.emcy import ErrorHistory as ErrorHistory
from syncline_samples.faults.emcy import Errors as Errors
from syncline_samples.faults.guarding import GuardToggleStuck as GuardToggleStuck
from syncline_samples.faults.guarding import GuardUnanswered as GuardUnanswered
from syncline_samples.faults.guarding import MasterSilent as MasterSilent
from syncline_samples.faults.guarding import RemoteOnHeartbeat as RemoteOnHeartbeat
from syncline_samples.faults.nmt import BootLoop as BootLoop
from syncline_samples.faults.nmt import Command as Command
from syncline_samples.faults.nmt import CommandIgnored as CommandIgnored
from syncline_samples.faults.nmt import DuplicateNode as DuplicateNode
from syncline_samples.faults.nmt import HeartbeatIrregular as HeartbeatIrregular
from syncline_samples.faults.nmt import HeartbeatPeriod as HeartbeatPeriod
from syncline_samples.faults.nmt import HeartbeatsMissing as HeartbeatsMissing
from syncline_samples.faults.nmt import LeavesOperational as LeavesOperational
from syncline_samples.faults.nmt import MalformedCommand as MalformedCommand
from syncline_samples.faults.nmt import PdoOutsideOperational as PdoOutsideOperational
from syncline_samples.faults.nmt import PowerLoss as PowerLoss
from syncline_samples.faults.nmt import UnknownState as UnknownState
from syncline_samples.faults.nmt import WatchdogReset as WatchdogReset
from syncline_samples.faults.pdo import ExtraPdos as ExtraPdos
from syncline_samples.faults.pdo import MissedPdos as MissedPdos
from syncline_samples.faults.pdo import PdoInhibitTime as PdoInhibitTime
from syncline_samples.faults.pdo import PdoRequests as PdoRequests
from syncline_samples.faults.pdo import TpdoStops as TpdoStops
from syncline_samples.faults.pdo import WrongLengthPdos as WrongLengthPdos
from syncline_samples.faults.recorder import ClockStep as ClockStep
from syncline_samples.faults.recorder import ControllerState as ControllerState
from syncline_samples.faults.recorder import ErrorFrames as ErrorFrames
from syncline_samples.faults.recorder import Overrun as Overrun
from syncline_samples.faults.recorder import RecorderBusOff as RecorderBusOff
from syncline_samples.faults.recorder import RecorderGap as RecorderGap
from syncline_samples.faults.recorder import RecordingBegins as RecordingBegins
from syncline_samples.faults.sdo import BAD_VALUE as BAD_VALUE
from syncline_samples.faults.sdo import DEVICE_TYPE as DEVICE_TYPE
from syncline_samples.faults.sdo import LOG as LOG
from syncline_samples.faults.sdo import NAME as NAME
from syncline_samples.faults.sdo import BlockCrcWrong as BlockCrcWrong
from syncline_samples.faults.sdo import BlockSegmentsLost as BlockSegmentsLost
from syncline_samples.faults.sdo import NodeSearch as NodeSearch
from syncline_samples.faults.sdo import Preset as Preset
from syncline_samples.faults.sdo import SdoAccess as SdoAccess
from syncline_samples.faults.sdo import SdoClientAborts as SdoClientAborts
from syncline_samples.faults.sdo import SdoClientStops as SdoClientStops
from syncline_samples.faults.sdo import SdoLate as SdoLate
from syncline_samples.faults.sdo import SdoRefused as SdoRefused
from syncline_samples.faults.sdo import SdoReset as SdoReset
from syncline_samples.faults.sdo import SdoServerAborts as SdoServerAborts
from syncline_samples.faults.sdo import SdoServerStops as SdoServerStops
from syncline_samples.faults.sdo import SdoSilent as SdoSilent
from syncline_samples.faults.sdo import SdoTwoClients as SdoTwoClients
from syncline_samples.faults.sensor import AngleJump as AngleJump
from syncline_samples.faults.services import BusPowerOff as BusPowerOff
from syncline_samples.faults.services import LssSession as LssSession
from syncline_samples.faults.services import TimeService as TimeService
from syncline_samples.faults.settings import PDO_OFF as PDO_OFF
from syncline_samples.faults.settings import FactoryReset as FactoryReset
from syncline_samples.faults.settings import MoveEmcy as MoveEmcy
from syncline_samples.faults.settings import MovePdo as MovePdo
from syncline_samples.faults.settings import MoveSdo as MoveSdo
from syncline_samples.faults.settings import MoveSync as MoveSync
from syncline_samples.faults.settings import NodeIdChange as NodeIdChange
from syncline_samples.faults.settings import RemapPdo as RemapPdo
from syncline_samples.faults.settings import ResetBySdo as ResetBySdo
from syncline_samples.faults.settings import Storage as Storage
from syncline_samples.faults.settings import number_changed as number_changed
from syncline_samples.faults.sync import MissingSyncs as MissingSyncs
from syncline_samples.faults.sync import SecondSyncProducer as SecondSyncProducer
from syncline_samples.faults.sync import SyncJitter as SyncJitter
from syncline_samples.faults.sync import SyncOutage as SyncOutage

__all__ = [
    "BAD_VALUE",
    "DEVICE_TYPE",
    "LOG",
    "MAY_TELL",
    "NAME",
    "PDO_OFF",
    "AngleJump",
    "BlockCrcWrong",
    "BlockSegmentsLost",
    "BootLoop",
    "BusPowerOff",
    "CableLoose",
    "ClockStep",
    "Command",
    "CommandIgnored",
    "ControllerState",
    "DuplicateNode",
    "Emcy",
    "EmcyInhibitTime",
    "EmcyMalformed",
    "EmcyStorm",
    "EmcyWhileStopped",
    "ErrorFrames",
    "ErrorHistory",
    "Errors",
    "ExtraPdos",
    "FactoryReset",
    "GuardToggleStuck",
    "GuardUnanswered",
    "HeartbeatIrregular",
    "HeartbeatPeriod",
    "HeartbeatsMissing",
    "LeavesOperational",
    "LssSession",
    "MalformedCommand",
    "MasterSilent",
    "MissedPdos",
    "MissingSyncs",
    "MoveEmcy",
    "MovePdo",
    "MoveSdo",
    "MoveSync",
    "NodeBusOff",
    "NodeIdChange",
    "NodeSearch",
    "Overrun",
    "PdoInhibitTime",
    "PdoOutsideOperational",
    "PdoRequests",
    "PowerLoss",
    "Preset",
    "RecorderBusOff",
    "RecorderGap",
    "RecordingBegins",
    "RemapPdo",
    "RemoteOnHeartbeat",
    "ResetBySdo",
    "SdoAccess",
    "SdoClientAborts",
    "SdoClientStops",
    "SdoLate",
    "SdoRefused",
    "SdoReset",
    "SdoServerAborts",
    "SdoServerStops",
    "SdoSilent",
    "SdoTwoClients",
    "SecondSyncProducer",
    "Storage",
    "SyncJitter",
    "SyncOutage",
    "TimeService",
    "TpdoStops",
    "UnknownState",
    "WatchdogReset",
    "WrongLengthPdos",
    "number_changed",
]
