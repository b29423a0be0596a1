-- Live results by flight: number, fraction solved, tip deflection. They use the installation's constants.
CREATE VIEW live_by_flight AS
SELECT solve, aircraft, aircraft_type, wing, recorder_id, flight, min(utc) AS began, count(*) AS results,
       count(*) FILTER (status IN ('ok', 'doubtful')) / count(*) AS solved_share,
       (count(*) - 1) / nullif(epoch(max(utc)) - epoch(min(utc)), 0) AS rate_hz,
       avg(tip_deflection_m) AS deflection_m, stddev_samp(tip_deflection_m) AS scatter_m, min(tip_deflection_m) AS least_m, max(tip_deflection_m) AS most_m,
       sqrt(avg(sigma_tip_deflection_m ** 2)) AS sigma_m
FROM live GROUP BY ALL;
