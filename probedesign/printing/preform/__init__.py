"""PreForm's local API: jobs for a Formlabs printer, prepared on the machine where PreFormServer runs.

Source: Formlabs Local API 0.9, github.com/Formlabs/formlabs-api-python (local-api/formlabs-api-local-openapi.yaml).
"""
