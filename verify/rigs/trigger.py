"""std_srvs/srv/Trigger as rmw_cyclonedds lays it out, for the peers by Cyclone DDS."""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint8, uint64


# rmw_cyclonedds puts this header before each request and response: the half of the client's GUID, and a number.
@dataclass
class Request(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    number: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class Response(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    number: int64
    success: bool
    message: str
