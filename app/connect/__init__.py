"""What other programs see of softcal: REST, webhooks, mail, MQTT, OPC UA, from one source.

Nothing here is imported by another command; its libraries are the extra `connect`.
"""
