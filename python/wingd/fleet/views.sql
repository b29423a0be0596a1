-- Views of the report, also open to queries: wingd-fleet query --lake LAKE "SELECT ... FROM deflection_by_aircraft".
-- shots, markers, parameters, span, shape, live, live_markers, live_span are the tables of all chosen solves; `frames` holds the columns of
-- shots that most queries need. More views are in shape.sql, span.sql, mount.sql, detection.sql and live.sql. A wing is the left or right wing of an
-- aircraft; if it is not given, each recorder counts as a wing of its own.

-- Mean, minimum and maximum deflection of the tip marker of a flight, with mean weight and load (weight times load factor). Tip
-- markers of different wings are at different places: deflections are compared along the span by the views of shape.sql.
CREATE VIEW deflection_by_flight AS
SELECT solve, aircraft, aircraft_type, wing, recorder_id, flight, tip_marker,
       min(utc) AS began, count(*) AS frames, avg(tip_deflection_m) AS deflection_m, min(tip_deflection_m) AS least_m, max(tip_deflection_m) AS most_m,
       sqrt(avg(tip_sigma_deflection_m ** 2)) AS sigma_frame_m,
       avg(weight_kg) AS weight_kg, avg(load_factor) AS load_factor, avg(load_t) AS load_t
FROM frames WHERE status = 'ok' AND tip_deflection_m IS NOT NULL
GROUP BY ALL;

-- The scatter of flights over root n has no errors common to them: it is no standard deviation of the mean.
CREATE VIEW deflection_by_aircraft AS
SELECT solve, aircraft, wing, any_value(aircraft_type) AS aircraft_type, tip_marker, count(*) AS flights, sum(frames) AS frames,
       avg(deflection_m) AS deflection_m, stddev_samp(deflection_m) / sqrt(count(*)) AS scatter_of_mean_m,
       min(least_m) AS least_m, max(most_m) AS most_m, sqrt(avg(sigma_frame_m ** 2)) AS sigma_frame_m
FROM deflection_by_flight GROUP BY solve, aircraft, wing, tip_marker;

-- Shots without a result, by reason; numbers in reasons are replaced so that equal reasons are grouped.
CREATE VIEW failing AS
SELECT solve, aircraft, recorder_id, flight, status, count(*) AS shots,
       regexp_replace(coalesce(reason, camera_failures, status), '[0-9]+([.][0-9]+)?', '#', 'g') AS reason
FROM frames WHERE status <> 'ok' GROUP BY ALL;

CREATE VIEW failing_flights AS
SELECT solve, aircraft, recorder_id, flight, count(*) AS shots, count(*) FILTER (status = 'ok') AS ok,
       mode(reason) FILTER (status <> 'ok') AS reason
FROM frames GROUP BY ALL HAVING count(*) FILTER (status = 'ok') < count(*);

-- The same frames in two solves; null if the tip is another marker. Their standard deviations are not independent: the
-- difference is compared with the larger one.
CREATE MACRO compared(one, other) AS TABLE
SELECT a.aircraft, a.wing, recorder_id, flight, series, shot, a.status AS status_one, b.status AS status_other,
       CASE WHEN a.tip_marker = b.tip_marker THEN b.tip_deflection_m - a.tip_deflection_m END AS difference_m, greatest(a.tip_sigma_deflection_m, b.tip_sigma_deflection_m) AS sigma_m,
       a.tip_deflection_m AS deflection_one_m, b.tip_deflection_m AS deflection_other_m
FROM (FROM frames WHERE solve = one) a JOIN (FROM frames WHERE solve = other) b
    USING (recorder_id, flight, series, shot);

CREATE MACRO compared_by_aircraft(one, other) AS TABLE
SELECT aircraft, wing, count(*) AS frames, avg(difference_m) AS mean_m, sqrt(avg(difference_m ** 2)) AS rms_m,
       max(abs(difference_m)) AS most_m, sqrt(avg((difference_m / sigma_m) ** 2)) AS over_sigma,
       count(*) FILTER (status_one = 'ok' AND status_other <> 'ok') AS lost,
       count(*) FILTER (status_one <> 'ok' AND status_other = 'ok') AS won
FROM compared(one, other) GROUP BY ALL;
