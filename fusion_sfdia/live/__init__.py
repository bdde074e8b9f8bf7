"""Bridges of a `Watch`: text, OPC UA and MQTT in, verdicts and alarms out; its saving, status and security."""
