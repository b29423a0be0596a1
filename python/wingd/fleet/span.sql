-- Mean shape of a series by the model: the adjusted curve has all stations in every frame, whichever markers are hidden. The
-- frames share most of their errors, so the standard deviation is that of a frame; wingd export --table series has that of
-- the mean, and scatter is that of single frames about it.
CREATE VIEW shape_by_series AS
SELECT solve, aircraft, wing, recorder_id, flight, series, round(arc_length_m, 3) AS arc_length_m, count(*) AS frames,
       avg(deflection_m) AS deflection_m, sqrt(avg(sigma_deflection_m ** 2)) AS sigma_m, stddev_samp(deflection_m) AS scatter_m,
       avg(twist_deg) AS twist_deg, sqrt(avg(sigma_twist_deg ** 2)) AS sigma_twist_deg,
       avg(streamwise_twist_deg) AS streamwise_twist_deg, sqrt(avg(sigma_streamwise_twist_deg ** 2)) AS sigma_streamwise_twist_deg,
       avg(mach) AS mach, avg(weight_kg) AS weight_kg, avg(load_factor) AS load_factor, avg(angle_of_attack_deg) AS angle_of_attack_deg
FROM span WHERE status = 'ok' AND arc_length_m IS NOT NULL
GROUP BY ALL;
