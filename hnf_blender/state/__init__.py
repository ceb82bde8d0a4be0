"""State of the session that no file stores: validity of strokes' bakes, the running job, the last results.

Read `session_state.py` first; `status_tracker.py` keeps the statuses of strokes up to date, `labels.py` turns them into
text.
"""
