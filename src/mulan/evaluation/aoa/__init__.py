"""Angle of arrival on recorded links with known geometry, beside what others reported for the same links."""
