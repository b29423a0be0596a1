-- Views of the report, also open to queries: wingd-fleet query --lake LAKE "SELECT ... FROM deflection_by_aircraft".
-- shots, markers, parameters, span, live, live_markers, live_span are the tables of all chosen solves; `frames` holds the columns of
-- shots that most queries need. More views are in mount.sql, detection.sql and live.sql. A wing is the left or right wing of an
-- aircraft; if it is not given, each recorder counts as a wing of its own.

-- Mean, minimum and maximum deflection of a flight, with mean weight and load (weight times load factor).
CREATE VIEW deflection_by_flight AS
SELECT solve, aircraft, aircraft_type, wing, recorder_id, flight,
       min(utc) AS began, count(*) AS frames, avg(tip_deflection_m) AS deflection_m, min(tip_deflection_m) AS least_m, max(tip_deflection_m) AS most_m,
       sqrt(avg(tip_sigma_deflection_m ** 2)) AS sigma_m,
       avg(weight_kg) AS weight_kg, avg(load_factor) AS load_factor, avg(load_t) AS load_t
FROM frames WHERE status = 'ok' AND tip_deflection_m IS NOT NULL
GROUP BY ALL;

CREATE VIEW deflection_by_aircraft AS
SELECT solve, aircraft, wing, any_value(aircraft_type) AS aircraft_type, count(*) AS flights, sum(frames) AS frames,
       avg(deflection_m) AS deflection_m, stddev_samp(deflection_m) / sqrt(count(*)) AS sigma_mean_m,
       min(least_m) AS least_m, max(most_m) AS most_m, sqrt(avg(sigma_m ** 2)) AS sigma_frame_m
FROM deflection_by_flight GROUP BY solve, aircraft, wing;

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

-- Deflection = a + b load, by type: the line with which an aircraft is compared; null if all loads are equal.
CREATE VIEW line_of_type AS
SELECT solve, coalesce(aircraft_type, 'unknown') AS aircraft_type, count(*) AS frames,
       CASE WHEN min(load_t) < max(load_t) THEN regr_slope(tip_deflection_m, load_t) END AS slope_m_per_t,
       CASE WHEN min(load_t) < max(load_t) THEN regr_intercept(tip_deflection_m, load_t) END AS intercept_m,
       CASE WHEN min(load_t) < max(load_t)
            THEN sqrt(regr_syy(tip_deflection_m, load_t) * (1 - regr_r2(tip_deflection_m, load_t)) / nullif(count(*) - 2, 0)) END AS scatter_m,
       min(load_t) AS least_t, max(load_t) AS most_t
FROM frames WHERE status = 'ok' AND tip_deflection_m IS NOT NULL AND load_t IS NOT NULL
GROUP BY ALL;

-- Offset of an aircraft from its type's line. Frames of a flight share a mounting, so flights are counted. The frames of an
-- aircraft also share survey, camera and axis, whose errors do not average out: the full standard deviation of a frame is
-- treated as common to them, in addition to the scatter of flights.
CREATE VIEW aircraft_against_type AS
WITH residuals AS (
    SELECT solve, aircraft, aircraft_type, wing, recorder_id, flight,
           avg(tip_deflection_m - intercept_m - slope_m_per_t * load_t) AS residual_m, avg(tip_sigma_deflection_m) AS sigma_m
    FROM (SELECT * REPLACE (coalesce(aircraft_type, 'unknown') AS aircraft_type) FROM frames)
    JOIN line_of_type USING (solve, aircraft_type)
    WHERE status = 'ok' AND tip_deflection_m IS NOT NULL AND load_t IS NOT NULL
    GROUP BY ALL)
SELECT *, mean_m / sqrt(coalesce(scatter_m, 0) ** 2 + common_m ** 2) AS over_sigma
FROM (SELECT solve, aircraft, aircraft_type, wing, count(*) AS flights, avg(residual_m) AS mean_m,
             stddev_samp(residual_m) / sqrt(count(*)) AS scatter_m, sqrt(avg(sigma_m ** 2)) AS common_m
      FROM residuals GROUP BY ALL);

-- Shots without a result, by reason; numbers in reasons are replaced so that equal reasons are grouped.
CREATE VIEW failing AS
SELECT solve, aircraft, recorder_id, flight, status, count(*) AS shots,
       regexp_replace(coalesce(reason, camera_failures, status), '[0-9]+([.][0-9]+)?', '#', 'g') AS reason
FROM frames WHERE status <> 'ok' GROUP BY ALL;

CREATE VIEW failing_flights AS
SELECT solve, aircraft, recorder_id, flight, count(*) AS shots, count(*) FILTER (status = 'ok') AS ok,
       mode(reason) FILTER (status <> 'ok') AS reason
FROM frames GROUP BY ALL HAVING count(*) FILTER (status = 'ok') < count(*);

-- The same frames in two solves. Their standard deviations are not independent: the difference is compared with
-- the larger one.
CREATE MACRO compared(one, other) AS TABLE
SELECT a.aircraft, a.wing, recorder_id, flight, series, shot, a.status AS status_one, b.status AS status_other,
       b.tip_deflection_m - a.tip_deflection_m AS difference_m, greatest(a.tip_sigma_deflection_m, b.tip_sigma_deflection_m) AS sigma_m,
       a.tip_deflection_m AS deflection_one_m, b.tip_deflection_m AS deflection_other_m
FROM (FROM frames WHERE solve = one) a JOIN (FROM frames WHERE solve = other) b
    USING (recorder_id, flight, series, shot);

CREATE MACRO compared_by_aircraft(one, other) AS TABLE
SELECT aircraft, wing, count(*) AS frames, avg(difference_m) AS mean_m, sqrt(avg(difference_m ** 2)) AS rms_m,
       max(abs(difference_m)) AS most_m, sqrt(avg((difference_m / sigma_m) ** 2)) AS over_sigma,
       count(*) FILTER (status_one = 'ok' AND status_other <> 'ok') AS lost,
       count(*) FILTER (status_one <> 'ok' AND status_other = 'ok') AS won
FROM compared(one, other) GROUP BY ALL;
