"""What other programs of a plant see of softcal: REST, webhooks, mail, MQTT and OPC UA, all from one source of events.

Nothing here is imported by another command; its libraries are the extra `connect`.
"""
