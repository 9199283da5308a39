//! Names of groups in topics.

use crate::shared::Shared;

/// Returns the part of a topic's name for `name`: ROS 2 permits letters, digits and single underscores.
pub(crate) fn topic_part(name: &str) -> String {
    let mut part = String::new();
    for letter in name.chars() {
        let letter = if letter.is_ascii_alphanumeric() { letter } else { '_' };
        if letter != '_' || !part.ends_with('_') {
            part.push(letter);
        }
    }
    if part.starts_with(|letter: char| letter.is_ascii_digit()) { format!("_{part}") } else { part }
}

/// Returns the part of a topic's name for each group.
pub(crate) fn group_topics(shared: &Shared) -> Result<Vec<String>, String> {
    let mut topics: Vec<String> = Vec::new();
    for link in &shared.groups {
        let topic = topic_part(&link.group.name);
        if topics.contains(&topic) {
            return Err(format!(
                "two groups have the topic /motord/{topic}: rename one in the configuration of motord"
            ));
        }
        topics.push(topic);
    }
    Ok(topics)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::Name;

    #[test]
    fn any_group_name_is_a_topic() {
        let parts = ["legs", "left-arm", "a--b", "2nd", "ärm.1"].map(topic_part);
        assert_eq!(parts, ["legs", "left_arm", "a_b", "_2nd", "_rm_1"]);
        assert!(parts.iter().all(|part| Name::new(&format!("/motord/{part}"), "state").is_ok()));
    }
}
