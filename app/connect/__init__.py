"""Interfaces to other programs: REST, webhooks, mail, MQTT, OPC UA, from one source of events.

Nothing here is imported by another command; its libraries are the extra `connect`.
"""
