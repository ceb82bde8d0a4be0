"""State of the session that no file stores: statuses of strokes, the running job, the last results.

Read `session_state.py` first; `status_tracker.py` keeps the statuses up to date, `labels.py` turns them into text.
"""
